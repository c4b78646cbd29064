"""Clock and brightness by key presses, on the twin's own machine and on one that refuses."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest
from textual.widgets import Input

from device.errors import MachineError
from device.machine.interfaces import ClockStatus, Machine
from device.machine.machines import TWIN_KEY, SysfsBacklight, TwinBacklight, TwinClock, TwinWifi
from device.tui.drawing.text import local_time
from tests.device.tui.conftest import Stage
from tests.device.tui.test_setup_screen import _choose, _panel


class OwnClock(TwinClock):
    """A clock that can be set, or says why not."""

    def __init__(self, refusal: str = "") -> None:
        super().__init__()
        self.refusal = refusal
        self.was_set_to: datetime | None = None

    def status(self) -> ClockStatus:
        if self.refusal:
            raise MachineError(self.refusal)
        return super().status()

    def set_time(self, local: datetime) -> None:
        if self.refusal:
            raise MachineError(self.refusal)
        self.was_set_to = local


@pytest.mark.parametrize("size", [(40, 16), (80, 24)])
def test_the_time_zone_is_chosen_by_region_and_place(
    play: Callable[..., None], root: Path, size: tuple[int, int]
) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "clock")
        assert "Zone UTC;" in _panel(stage)
        assert "was never set" in _panel(stage)
        await stage.press("enter", "down", "enter")
        assert "> America" in stage.text()
        await stage.press("down", "down", "enter", "enter")
        assert stage.instrument.machine.clock.status().time_zone == "Europe/Berlin"
        assert "The time zone is Europe/Berlin." in stage.text()
        assert "Europe/Berlin;" in _panel(stage)

    play(scenario, root, size=size)


def test_date_and_time_are_set_as_they_are_typed(play: Callable[..., None], root: Path) -> None:
    clock = OwnClock()

    async def scenario(stage: Stage) -> None:
        await _choose(stage, "clock")
        await stage.press("enter", "enter")
        date, time = stage.app.screen.query(Input)
        date.value, time.value = "2026-11-23", "14 o'clock"
        time.focus()
        await stage.press("enter")
        assert "write a date such as" in stage.text()
        time.value = "14:05"
        await stage.press("enter")
        assert clock.was_set_to == datetime(2026, 11, 23, 14, 5)
        assert "The clock is set to 2026-11-23 14:05." in stage.text()

    play(scenario, root, size=(100, 30), machine=Machine(clock, TwinBacklight(), TwinWifi()))


def test_a_clock_that_cannot_be_set_says_why(play: Callable[..., None], root: Path) -> None:
    refusal = "timedatectl is not installed on this machine"

    async def scenario(stage: Stage) -> None:
        await _choose(stage, "clock")
        assert f"! {refusal}" in _panel(stage)
        await stage.press("enter", "enter")
        stage.app.screen.query(Input).last().focus()
        await stage.press("enter")
        assert f"! {refusal}" in stage.text().replace(_panel(stage), "")

    play(scenario, root, size=(100, 30), machine=Machine(OwnClock(refusal), TwinBacklight(), TwinWifi()))


def test_brightness_goes_to_the_next_level_and_from_the_last_to_the_first(
    play: Callable[..., None], root: Path, tmp_path: Path
) -> None:
    panel = tmp_path / "backlight" / "panel"
    panel.mkdir(parents=True)
    (panel / "max_brightness").write_text("200")
    (panel / "brightness").write_text("200")

    async def scenario(stage: Stage) -> None:
        await _choose(stage, "brightness")
        assert "Now 100%." in _panel(stage)
        seen = []
        for _ in range(5):
            await stage.press("enter")
            seen.append(int((panel / "brightness").read_text()))
        assert seen == [150, 100, 50, 20, 200]
        assert "Brightness 100%." in stage.text()

    play(scenario, root, machine=Machine(TwinClock(), SysfsBacklight(panel.parent), TwinWifi()))


def test_without_a_panel_the_entry_says_so(play: Callable[..., None], root: Path, tmp_path: Path) -> None:
    words = "This machine has no panel whose brightness can be set."

    async def scenario(stage: Stage) -> None:
        await _choose(stage, "brightness")
        assert _panel(stage).startswith(words)
        await stage.press("enter")
        assert f"! {words}" in stage.text()

    play(scenario, root, machine=Machine(TwinClock(), SysfsBacklight(tmp_path / "absent"), TwinWifi()))


def test_a_time_from_a_clock_that_was_never_set_is_no_time() -> None:
    assert local_time(datetime(1970, 1, 1, 0, 33, tzinfo=UTC)) == "time not known"
    assert local_time(datetime(2026, 7, 1, tzinfo=UTC)) != "time not known"


def test_a_jump_of_the_clock_does_not_disorder_scans(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        clock = stage.bench.clock
        for jump_s in (1.8e9, -1.7e9):
            await stage.object_pressed()
            clock.jump_wall(jump_s)
        await stage.object_pressed()
        scans = stage.instrument.history().scans
        assert [scan.counter for scan in scans] == [3, 2, 1]
        years = [scan.wall_time.year for scan in scans]
        assert years[0] < years[1]  # the third is dated before the second
        await stage.press("3")
        assert "time not known" in stage.text()

    play(scenario, root)


@pytest.mark.parametrize("size", [(40, 16), (80, 24)])
def test_a_network_is_joined_with_its_password_which_is_not_shown(
    play: Callable[..., None], root: Path, size: tuple[int, int]
) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "wifi")
        assert "In no Wi-Fi network." in _panel(stage)
        await stage.press("enter")
        assert "80% workshop" in stage.text()
        assert "company cannot be joined" in stage.text()
        await stage.press("enter", *"short", "enter")
        assert "! a Wi-Fi password has 8 to 63" in stage.text()
        await stage.press(*"-password", "enter")
        assert "! the password of workshop is wrong: try again" in stage.text()
        assert stage.instrument.machine.wifi.active() is None
        await stage.press("enter", "enter", *TWIN_KEY)
        assert TWIN_KEY not in stage.text()
        await stage.press("enter")
        assert "Joined workshop" in stage.text()
        assert "In the network workshop." in _panel(stage)

    play(scenario, root, size=size)


def test_an_open_network_asks_for_nothing(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "wifi")
        await stage.press("enter", "down", "enter")
        assert "In the network visitors." in _panel(stage)

    play(scenario, root)
