"""Reports to the service manager for parts that answer, come late, or never come."""

from collections.abc import Callable

import pytest
from emulated_board import LIGHTS_AT, EmulatedBoard, emulated_hardware

from device.cli.instrument_commands import run_headless
from device.cli.service import BROKEN_WAIT_S, SdNotify, ServiceReport
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.simulator.bench import SimulatedScene


class Heard(SdNotify):
    """Records messages to a service manager with their times, s."""

    def __init__(self, bench: SimulatedScene) -> None:
        super().__init__("@nobody", 60.0)
        self._now_s: Callable[[], float] = lambda: bench.clock.monotonic_ns() * 1e-9
        self.began_s = self._now_s()
        self.said: list[tuple[float, str]] = []

    def _send(self, message: str) -> None:
        if message != "WATCHDOG=1":
            self.said.append((self._now_s() - self.began_s, message.removesuffix("\nWATCHDOG=1")))


@pytest.fixture
def emulated(bench: SimulatedScene) -> EmulatedBoard:
    return emulated_hardware(bench, "PCA9955B")


def served(
    emulated: EmulatedBoard, store: BundleStore, for_s: float, at_s: dict[float, Callable[[], None]]
) -> list[tuple[float, str]]:
    """Messages to the service manager while serving for `for_s`, with actions at given times (s).

    Without watchdog beats, and without changes of the free space alone.
    """
    clock, heard = emulated.bench.clock, Heard(emulated.bench)
    waiting = sorted(at_s.items())

    def go_on() -> bool:
        report.turn(instrument.state)
        passed_s = clock.monotonic_ns() * 1e-9 - heard.began_s
        while waiting and waiting[0][0] <= passed_s:
            waiting.pop(0)[1]()
        return passed_s < for_s

    with Instrument(emulated.hardware, store) as instrument:
        report = ServiceReport(heard, clock)
        run_headless(instrument, lambda _line: None, lambda _what: None, go_on)
        report.ended()
    first, *later = heard.said
    return [first] + [new for old, new in zip([first, *later], later, strict=False) if not only_room(old[1], new[1])]


def only_room(before: str, after: str) -> bool:
    """Whether both say that it is ready."""
    return "STATUS=ready: room for" in before and after.startswith("STATUS=ready: room for")


def test_it_is_ready_once_frames_come(emulated: EmulatedBoard, calibrated: BundleStore) -> None:
    (at_s, ready), *later = served(emulated, calibrated, 3.0, {})
    assert ready.startswith("READY=1\nSTATUS=ready: room for")
    assert at_s < 0.5
    assert [said for _, said in later] == ["STOPPING=1"]


def test_a_part_that_comes_late_is_waited_for(emulated: EmulatedBoard, calibrated: BundleStore) -> None:
    unplugged = emulated.wire.faults.unplugged
    unplugged.add(LIGHTS_AT)
    (_, absent), (at_s, ready), _ = served(emulated, calibrated, 9.0, {5.0: unplugged.clear})
    assert absent.startswith("STATUS=out of order: no chip answers at 0x15 on bus 1")
    assert ready.startswith("READY=1\nSTATUS=ready: room for")
    assert 5.0 < at_s < BROKEN_WAIT_S


def test_a_part_that_never_comes_is_in_the_status(emulated: EmulatedBoard, calibrated: BundleStore) -> None:
    unplugged = emulated.wire.faults.unplugged
    unplugged.add(LIGHTS_AT)
    _, (at_s, ready), (_, mended), _ = served(emulated, calibrated, 25.0, {18.0: unplugged.clear})
    assert ready.startswith("READY=1\nSTATUS=out of order: no chip answers at 0x15 on bus 1")
    assert BROKEN_WAIT_S <= at_s < 18.0
    assert mended.startswith("STATUS=ready: room for")


def test_a_part_that_goes_away_later_is_in_the_status(emulated: EmulatedBoard, calibrated: BundleStore) -> None:
    def tear_off() -> None:
        emulated.bench.faults.camera_missing = True

    said = [line for _, line in served(emulated, calibrated, 30.0, {5.0: tear_off})]
    assert said[0].startswith("READY=1\nSTATUS=ready")
    assert any(line.startswith("STATUS=out of order: ") and "imx296@1a" in line for line in said[1:])


def test_without_a_calibration_it_is_ready_and_says_what_is_missing(
    emulated: EmulatedBoard, store: BundleStore
) -> None:
    (_, said), _ = served(emulated, store, 2.0, {})
    assert said.startswith("READY=1\nSTATUS=no scans yet: no calibration is active")
