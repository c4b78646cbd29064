"""Messages to the service manager over a real socket; none without one."""

import os
import socket
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from device.cli.instrument_commands import run_headless
from device.cli.service import SdNotify
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene


@pytest.fixture
def heard(tmp_path: Path) -> Iterator[socket.socket]:
    """The service manager's end, at `tmp_path / "notify"`."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.setblocking(False)
        yield listening


def messages(listening: socket.socket) -> list[str]:
    received = []
    while True:
        try:
            received.append(listening.recv(4096).decode())
        except BlockingIOError:
            return received


def environment(tmp_path: Path, **more: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "60000000", **more}


def test_messages(tmp_path: Path, heard: socket.socket) -> None:
    notify = SdNotify.from_environment(environment(tmp_path))
    notify.ready("ready,\nroom for 3 scans")
    notify.alive()
    notify.stopping()
    assert messages(heard) == ["READY=1\nSTATUS=ready, room for 3 scans\nWATCHDOG=1", "WATCHDOG=1", "STOPPING=1"]
    assert notify.longest_wait_s == 15.0


def test_a_name_in_the_abstract_namespace(tmp_path: Path) -> None:
    name = f"retrograph-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name}")
        listening.setblocking(False)
        SdNotify(f"@{name}", None).stopping()
        assert messages(listening) == ["STOPPING=1"]


@pytest.mark.parametrize(
    "said",
    [
        {},
        {"NOTIFY_SOCKET": ""},
        {"WATCHDOG_USEC": "60000000"},
    ],
)
def test_without_a_service_manager_nothing_is_sent(said: dict[str, str]) -> None:
    notify = SdNotify.from_environment(said)
    notify.ready("ready")
    notify.alive()
    assert notify.longest_wait_s is None
    assert not notify.power_off()


@pytest.mark.parametrize("more", [{"WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "soon"}])
def test_a_watchdog_for_another_process_is_not_fed(tmp_path: Path, heard: socket.socket, more: dict[str, str]) -> None:
    notify = SdNotify.from_environment(environment(tmp_path, **more))
    notify.alive()
    assert messages(heard) == []
    assert notify.longest_wait_s is None


def test_a_service_manager_that_has_gone_costs_nothing(tmp_path: Path, heard: socket.socket) -> None:
    """Neither message raises: without the closed socket, then without its file."""
    notify = SdNotify.from_environment(environment(tmp_path))
    heard.close()
    notify.ready("ready")
    (tmp_path / "notify").unlink()
    notify.alive()


def test_power_off_is_a_file_that_systemd_waits_for(tmp_path: Path) -> None:
    notify = SdNotify.from_environment(environment(tmp_path, RUNTIME_DIRECTORY=str(tmp_path)))
    assert notify.power_off()
    assert (tmp_path / "poweroff").exists()
    units = Path(__file__).parents[3] / "systemd"
    assert "PathExists=/run/retroscan/poweroff\n" in (units / "retrograph-poweroff.path").read_text(encoding="utf-8")
    assert not SdNotify(str(tmp_path / "notify"), None, tmp_path / "gone").power_off()


def test_the_work_loop_itself_feeds_the_watchdog(
    tmp_path: Path, heard: socket.socket, hardware: Hardware, bench: SimulatedScene, calibrated: BundleStore
) -> None:
    """Each turn is one beat, also of a turn that scans; no turn lasts longer than the watchdog lets it."""
    notify = SdNotify.from_environment(environment(tmp_path))
    clock = bench.clock
    began_ns = clock.monotonic_ns()
    bench.schedule_button(ButtonPress(began_ns + 1_000_000_000, 0.1))
    beats_ns = [began_ns]
    received: list[str] = []

    def go_on() -> bool:
        notify.alive()
        received.extend(messages(heard))
        beats_ns.append(clock.monotonic_ns())
        return beats_ns[-1] - began_ns < 2.5e9

    with Instrument(hardware, calibrated) as instrument:
        run_headless(instrument, lambda _line: None, print, go_on)
    assert len(calibrated.scans().bundles) == 1
    assert received == ["WATCHDOG=1"] * (len(beats_ns) - 1)
    longest_wait_s = notify.longest_wait_s
    assert longest_wait_s is not None
    assert max(later - earlier for earlier, later in pairwise(beats_ns)) * 1e-9 < longest_wait_s
