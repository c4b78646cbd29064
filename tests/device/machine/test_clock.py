"""The system's clock through an executable in the place of timedatectl."""

from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import pytest

from device.errors import MachineError
from device.machine.interfaces import ClockStatus
from device.machine.machines import TimedateClock

Fake = Callable[[str, str], Path]
Calls = Callable[[], list[str]]

SHOW = """case "$*" in
*show) printf 'Timezone=Europe/Berlin\\nNTP=yes\\nNTPSynchronized=%s\\n' no ;;
*list-timezones) printf 'Europe/Berlin\\nUTC\\n' ;;
esac"""
FLAGS = "--no-pager --no-ask-password"


def test_zone_and_state_are_read(fake: Fake) -> None:
    clock = TimedateClock(str(fake("timedatectl", SHOW)))
    assert clock.status() == ClockStatus("Europe/Berlin", is_synchronized=False)
    assert clock.zones() == ("Europe/Berlin", "UTC")


def test_time_servers_are_left_alone_for_the_moment_of_setting(fake: Fake, calls: Calls) -> None:
    TimedateClock(str(fake("timedatectl", ""))).set_time(datetime(2026, 11, 23, 14, 5))
    assert calls() == [f"{FLAGS} {what}" for what in ("set-ntp false", "set-time 2026-11-23 14:05:00", "set-ntp true")]


def test_a_time_that_is_refused_leaves_time_servers_on(fake: Fake, calls: Calls) -> None:
    refuses = 'case "$*" in *set-time*) echo "Failed to set time: Invalid argument" >&2; exit 1 ;; esac'
    with pytest.raises(MachineError, match="the clock cannot be read or set: Failed to set time: Invalid argument"):
        TimedateClock(str(fake("timedatectl", refuses))).set_time(datetime(2026, 11, 23, 14, 5))
    assert calls()[-1] == f"{FLAGS} set-ntp true"


def test_the_zone_is_set_by_its_name(fake: Fake, calls: Calls) -> None:
    TimedateClock(str(fake("timedatectl", ""))).set_zone("Asia/Tokyo")
    assert calls() == [f"{FLAGS} set-timezone Asia/Tokyo"]


@pytest.mark.parametrize(
    ("script", "sentence"),
    [
        ('echo "Failed to set time zone: Access denied" >&2; exit 1', "this user may not set the clock"),
        ('echo "Failed to connect to bus: Host is down" >&2; exit 1', "Failed to connect to bus: Host is down"),
    ],
)
def test_failures_are_one_sentence(fake: Fake, script: str, sentence: str) -> None:
    with pytest.raises(MachineError, match=sentence):
        TimedateClock(str(fake("timedatectl", script))).set_zone("UTC")


def test_a_machine_without_timedatectl_says_so(tmp_path: Path) -> None:
    with pytest.raises(MachineError, match="is not installed on this machine"):
        TimedateClock(str(tmp_path / "timedatectl")).status()
