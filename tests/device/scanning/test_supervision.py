"""What the service manager is told, over a real socket: nothing without one, and never more than the truth."""

import os
import socket
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from device.bundle_store import BundleStore
from device.scanning.supervision import Supervisor
from device.session.headless import run_headless
from device.session.instrument import Instrument
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.twin.bench import Bench


@pytest.fixture
def heard(tmp_path: Path) -> Iterator[socket.socket]:
    """The service manager's end, at `tmp_path / "notify"`."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.setblocking(False)
        yield listening


def messages(listening: socket.socket) -> list[str]:
    told = []
    while True:
        try:
            told.append(listening.recv(4096).decode())
        except BlockingIOError:
            return told


def environment(tmp_path: Path, **more: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "60000000", **more}


def test_what_is_told(tmp_path: Path, heard: socket.socket) -> None:
    supervisor = Supervisor.from_environment(environment(tmp_path))
    supervisor.ready("ready,\nroom for 3 scans")
    supervisor.alive()
    supervisor.stopping()
    assert messages(heard) == ["READY=1\nSTATUS=ready, room for 3 scans\nWATCHDOG=1", "WATCHDOG=1", "STOPPING=1"]
    assert supervisor.longest_wait_s == 15.0


def test_a_name_in_the_abstract_namespace(tmp_path: Path) -> None:
    name = f"retrograph-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name}")
        listening.setblocking(False)
        Supervisor(f"@{name}", None).stopping()
        assert messages(listening) == ["STOPPING=1"]


@pytest.mark.parametrize(
    "said",
    [
        {},
        {"NOTIFY_SOCKET": ""},
        {"WATCHDOG_USEC": "60000000"},
    ],
)
def test_without_a_service_manager_nothing_is_told(said: dict[str, str]) -> None:
    supervisor = Supervisor.from_environment(said)
    supervisor.ready("ready")
    supervisor.alive()
    assert supervisor.longest_wait_s is None
    assert not supervisor.power_off()


@pytest.mark.parametrize("more", [{"WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "soon"}])
def test_a_watchdog_that_is_not_meant_is_not_fed(tmp_path: Path, heard: socket.socket, more: dict[str, str]) -> None:
    supervisor = Supervisor.from_environment(environment(tmp_path, **more))
    supervisor.alive()
    assert messages(heard) == []
    assert supervisor.longest_wait_s is None


def test_a_service_manager_that_has_gone_costs_nothing(tmp_path: Path, heard: socket.socket) -> None:
    supervisor = Supervisor.from_environment(environment(tmp_path))
    heard.close()
    supervisor.ready("ready")
    (tmp_path / "notify").unlink()
    supervisor.alive()


def test_power_off_is_a_file_that_systemd_waits_for(tmp_path: Path) -> None:
    supervisor = Supervisor.from_environment(environment(tmp_path, RUNTIME_DIRECTORY=str(tmp_path)))
    assert supervisor.power_off()
    assert (tmp_path / "poweroff").exists()
    units = Path(__file__).parents[3] / "systemd"
    assert "PathExists=/run/retroscan/poweroff\n" in (units / "retrograph-poweroff.path").read_text(encoding="utf-8")
    assert not Supervisor(str(tmp_path / "notify"), None, tmp_path / "gone").power_off()


def test_the_work_loop_itself_feeds_the_watchdog(
    tmp_path: Path, heard: socket.socket, hardware: Hardware, bench: Bench, calibrated: BundleStore
) -> None:
    """Each turn is one beat, also of a turn that scans; no turn lasts longer than the watchdog lets it."""
    supervisor = Supervisor.from_environment(environment(tmp_path))
    clock = bench.clock
    began_ns = clock.monotonic_ns()
    bench.schedule_button(ButtonPress(began_ns + 1_000_000_000, 0.1))
    beats_ns = [began_ns]
    told: list[str] = []

    def go_on() -> bool:
        supervisor.alive()
        told.extend(messages(heard))
        beats_ns.append(clock.monotonic_ns())
        return beats_ns[-1] - began_ns < 2.5e9

    with Instrument(hardware, calibrated) as instrument:
        run_headless(instrument, lambda _line: None, print, go_on)
    assert len(calibrated.scans().bundles) == 1
    assert told == ["WATCHDOG=1"] * (len(beats_ns) - 1)
    longest_wait_s = supervisor.longest_wait_s
    assert longest_wait_s is not None
    assert max(later - earlier for earlier, later in pairwise(beats_ns)) * 1e-9 < longest_wait_s
