"""Scanning at every push on the real drivers: cues, long pushes, pushes while busy, faults and what follows them."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping

import pytest

from device.bundle_store import BundleStore
from device.scan_bundle import Annotations
from device.scanning.scanner import ScanOutcome
from device.scanning.selftest import selftest
from device.scanning.supervision import Supervisor
from device.scanning.watching import watch
from hal.errors import ButtonError, IndicatorError
from hal.interfaces import ButtonPress
from hal.rhythm_indicator import RhythmIndicator
from hal.twin.bench import Bench
from hal.twin.wired.gpio_wire import Edge
from hal.twin.wired.hardware import LIGHTS_AT, SPARE_CHANNEL, Wired, wired_hardware

SECOND = 1_000_000_000


class Watched:
    """A board that is watched until nobody pushes any more."""

    def __init__(self, wired: Wired, store: BundleStore) -> None:
        self.wired = wired
        self.store = store
        self.said: list[str] = []
        self.outcomes: list[ScanOutcome] = []
        self.then: Callable[[], None] = lambda: None

    def push(self, at_s: float, held_s: float = 0.1) -> None:
        now_ns = self.wired.bench.clock.monotonic_ns()
        self.wired.bench.schedule_button(ButtonPress(now_ns + round(at_s * SECOND), held_s))

    def run(self) -> None:
        def complain(what: object) -> None:
            self.said.append(str(what))
            self.then()

        with pytest.raises(ButtonError, match="nobody will push"):
            watch(
                self.wired.hardware,
                self.store,
                Annotations(),
                self.outcomes.append,
                complain,
                self.said.append,
                Supervisor(None, None),
            )


@pytest.fixture
def watched(bench: Bench, calibrated: BundleStore) -> Iterator[Watched]:
    wired = wired_hardware(bench, "PCA9955B")
    with wired.hardware:
        yield Watched(wired, calibrated)
    assert not any(wired.leds.currents_ma())
    assert wired.cameras.opened == wired.cameras.held_requests == wired.wire.opened == 0


def test_every_push_is_one_scan_with_its_cues(watched: Watched) -> None:
    shown: list[str] = []
    show = watched.wired.hardware.indicator.show
    watched.wired.hardware.indicator.show = lambda cue: (shown.append(cue), show(cue))[1]  # type: ignore[method-assign]
    watched.push(1.0)
    watched.push(9.0)
    watched.run()
    assert len(watched.outcomes) == 2
    assert len({outcome.bundle.scan_id for outcome in watched.outcomes}) == 2
    assert shown == ["idle", "busy", "may lift", "doubtful", "busy", "may lift", "doubtful"]


@pytest.mark.parametrize("held_s", [0.03, 0.5, 1.8])
def test_cue_and_frame_follow_the_push_and_not_the_release(watched: Watched, held_s: float) -> None:
    clock = watched.wired.bench.clock
    shown: dict[str, int] = {}
    show = watched.wired.hardware.indicator.show
    watched.wired.hardware.indicator.show = lambda cue: (  # type: ignore[method-assign]
        shown.setdefault(cue, clock.monotonic_ns()),
        show(cue),
    )[1]
    watched.push(1.0, held_s)
    pushed_ns = clock.monotonic_ns() + SECOND
    watched.run()
    assert 0 < shown["busy"] - pushed_ns <= 0.1 * SECOND
    assert shown["may lift"] - pushed_ns <= 0.5 * SECOND
    assert len(watched.outcomes) == 1


def test_a_long_push_tells_the_state_and_does_not_scan(watched: Watched) -> None:
    watched.push(1.0, held_s=2.5)
    watched.push(9.0)
    watched.run()
    assert len(watched.outcomes) == len(watched.store.scans().bundles) == 1
    watched.outcomes.clear()
    watched.push(1.0, held_s=12.0)
    watched.run()
    assert watched.outcomes == []
    assert "Held 2 s, no scan. Room for" in watched.said[-1]
    assert "Battery 50%" in watched.said[-1]


def test_a_push_while_busy_does_nothing_and_says_so(watched: Watched) -> None:
    watched.push(1.0)
    watched.push(1.15, held_s=0.03)
    watched.run()
    assert len(watched.outcomes) == 1
    assert "1 push(es) came while busy and did nothing" in watched.said[-1]


def _lights_unplugged(wired: Wired) -> Callable[[], None]:
    wired.wire.faults.unplugged.add(LIGHTS_AT)
    return wired.wire.faults.unplugged.clear


def _bus_stuck(wired: Wired) -> Callable[[], None]:
    wired.wire.faults.stuck = True
    return lambda: setattr(wired.wire.faults, "stuck", False)


def _camera_stalls(wired: Wired) -> Callable[[], None]:
    wired.bench.faults.camera_stalled = True
    return lambda: setattr(wired.bench.faults, "camera_stalled", False)


def _camera_torn_off(wired: Wired) -> Callable[[], None]:
    wired.bench.faults.camera_missing = True
    return lambda: setattr(wired.bench.faults, "camera_missing", False)


def _wrong_size(wired: Wired) -> Callable[[], None]:
    wired.cameras.faults.rows_lost = 4
    return lambda: setattr(wired.cameras.faults, "rows_lost", 0)


def _no_exposure_stated(wired: Wired) -> Callable[[], None]:
    wired.cameras.faults.without = "ExposureTime"
    return lambda: setattr(wired.cameras.faults, "without", "")


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (_lights_unplugged, "no chip answers at 0x15 on bus 1"),
        (_bus_stuck, "bus 1 is stuck"),
        (_camera_stalls, "delivers no frame, though it was restarted 2 times"),
        (_camera_torn_off, "imx296@1a is not there"),
        (_wrong_size, "268 rows of 768 bytes where it granted 272"),
        (_no_exposure_stated, "frames without ExposureTime"),
    ],
)
def test_a_fault_is_told_nothing_is_published_and_the_next_push_scans(
    watched: Watched, fault: Callable[[Wired], Callable[[], None]], sentence: str
) -> None:
    mend = fault(watched.wired)
    lit_ma: list[float] = []

    def look_and_mend() -> None:
        lit_ma.append(sum(watched.wired.leds.driven_ma()[:SPARE_CHANNEL]))
        mend()

    watched.then = look_and_mend
    watched.push(1.0)
    watched.push(40.0)
    watched.run()
    told = [line for line in watched.said if sentence in line]
    assert len(told) == 1
    assert lit_ma == [0.0]
    assert len(watched.outcomes) == 1
    assert len(watched.store.scans().bundles) == 1
    assert watched.wired.bench.clock.monotonic_ns() < 120 * SECOND


def test_lights_that_could_not_be_switched_off_are_dark_a_second_after_the_bus_is_back(watched: Watched) -> None:
    wired = watched.wired
    clock, lights = wired.bench.clock, wired.hardware.lights
    switch_on, wait = lights.switch_on, wired.line.wait
    back_ns: list[int] = []
    dark_ns: list[int] = []

    def switch_on_and_lose_the_chip(currents_ma: Mapping[str, float]) -> None:
        switch_on(currents_ma)
        wired.wire.faults.unplugged.add(LIGHTS_AT)
        lights.switch_on = switch_on  # type: ignore[method-assign]

    def wait_and_look(timeout_s: float | None) -> bool:
        now_ns = clock.monotonic_ns()
        if back_ns and not dark_ns and now_ns >= back_ns[0]:
            wired.wire.faults.unplugged.clear()
        lit = any(wired.leds.currents_ma())
        if back_ns and not lit and not dark_ns:
            dark_ns.append(now_ns)
        return wait(timeout_s)

    lights.switch_on = switch_on_and_lose_the_chip  # type: ignore[method-assign]
    wired.line.wait = wait_and_look  # type: ignore[method-assign]
    watched.then = lambda: back_ns.append(clock.monotonic_ns() + 5 * SECOND)
    watched.push(1.0)
    watched.run()
    assert "switching all channels off" in watched.said[-1]
    assert 0 <= dark_ns[0] - back_ns[0] <= 1.1 * SECOND
    assert watched.outcomes == []


def test_a_failing_indicator_costs_no_scan_and_does_not_keep_the_instrument_from_starting(
    bench: Bench, calibrated: BundleStore
) -> None:
    def fail(_on: bool) -> None:
        raise IndicatorError("the indicator on line 27 cannot be driven")

    wired = wired_hardware(bench, "PCA9955B")
    broken = RhythmIndicator(fail, lambda: fail(False), wired.bench.clock)
    board = dataclasses.replace(wired, hardware=dataclasses.replace(wired.hardware, indicator=broken))
    watched = Watched(board, calibrated)
    with board.hardware:
        watched.push(1.0)
        watched.run()
    assert len(watched.outcomes) == 1
    assert not any(wired.leds.currents_ma())
    blamed = [finding.part for finding in selftest(board.hardware) if finding.state == "failed"]
    assert blamed == ["indicator"]


def test_chatter_on_the_line_scans_nothing(watched: Watched) -> None:
    now_ns = watched.wired.bench.clock.monotonic_ns()
    watched.wired.line.chatter([Edge(now_ns + n * 2_000_000, n % 2 == 0) for n in range(1, 400)])
    watched.run()
    assert watched.outcomes == []
