"""The instrument without a screen, on the real drivers: cues, long pushes, faults and what follows them."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from device.bundle_store import BundleStore
from device.pairing.opening import PairingSetup
from device.scanning.selftest import selftest
from device.session.calibration_run import PATIENCE_S
from device.session.headless import run_headless
from device.session.instrument import Instrument
from hal.errors import IndicatorError
from hal.interfaces import ButtonPress, OperatorRequest
from hal.rhythm_indicator import RhythmIndicator
from hal.twin.bench import Bench
from hal.twin.wired.gpio_wire import Edge
from hal.twin.wired.hardware import LIGHTS_AT, Wired, wired_hardware

SECOND = 1_000_000_000


class Watched:
    """A board that serves its button without a screen."""

    def __init__(self, wired: Wired, store: BundleStore) -> None:
        self.wired = wired
        self.store = store
        self.said: list[str] = []
        setup = PairingSetup(host_key=store.root / "none")
        self.instrument = Instrument(wired.hardware, store, pairing=setup)

    @property
    def scans(self) -> int:
        return len(self.store.scans().bundles)

    def push(self, at_s: float, held_s: float = 0.1) -> None:
        now_ns = self.wired.bench.clock.monotonic_ns()
        self.wired.bench.schedule_button(ButtonPress(now_ns + round(at_s * SECOND), held_s))

    def run(self, for_s: float, until: Callable[[], bool] = lambda: False) -> None:
        clock = self.wired.bench.clock
        end_ns = clock.monotonic_ns() + round(for_s * SECOND)

        def complain(what: object) -> None:
            self.said.append(str(what))

        run_headless(self.instrument, self.said.append, complain, lambda: clock.monotonic_ns() < end_ns and not until())


@pytest.fixture
def watched(bench: Bench, calibrated: BundleStore) -> Iterator[Watched]:
    wired = wired_hardware(bench, "PCA9955B")
    watched = Watched(wired, calibrated)
    with watched.instrument:
        yield watched
    assert not any(wired.leds.currents_ma())
    assert wired.cameras.opened == wired.cameras.held_requests == wired.wire.opened == 0


def test_every_push_is_one_scan_with_its_cues(watched: Watched) -> None:
    shown: list[str] = []
    show = watched.wired.hardware.indicator.show
    watched.wired.hardware.indicator.show = lambda cue: (shown.append(cue), show(cue))[1]  # type: ignore[method-assign]
    watched.push(1.0)
    watched.push(2.5)
    watched.run(4.0)
    assert watched.scans == 2
    assert shown == ["busy", "may lift", "doubtful", "busy", "may lift", "doubtful"]
    assert sum(line.startswith("doubtful: hardly anything presses the skin") for line in watched.said) == 2


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
    watched.run(1.5 + held_s)
    assert 0 < shown["busy"] - pushed_ns <= 0.1 * SECOND
    assert shown["may lift"] - pushed_ns <= 0.5 * SECOND
    assert watched.scans == 1


def test_without_a_calibration_it_serves_and_refuses_every_push_with_its_cue(bench: Bench, tmp_path: Path) -> None:
    wired = wired_hardware(bench, "PCA9955B")
    watched = Watched(wired, BundleStore(tmp_path / "new", bench.clock))
    shown: list[str] = []
    with watched.instrument:
        show = wired.hardware.indicator.show
        wired.hardware.indicator.show = lambda cue: (shown.append(cue), show(cue))[1]  # type: ignore[method-assign]
        watched.push(1.0)
        watched.run(2.0)
    assert (shown, watched.scans) == (["refused: calibration"], 0)
    assert [line for line in watched.said if "retroscan calibrate" in line] == [watched.said[0], watched.said[-1]]


def test_it_calls_itself_ready_once_every_part_answers(bench: Bench, calibrated: BundleStore) -> None:
    wired = wired_hardware(bench, "PCA9955B")
    mend = _lights_unplugged(wired)
    watched = Watched(wired, calibrated)
    with watched.instrument:
        watched.run(3.0)
        assert [line[:13] for line in watched.said] == ["no chip answe"]
        mend()
        watched.run(3.0)
        assert [line[:5] for line in watched.said[1:]] == ["Ready"]


def test_a_long_push_tells_the_state_and_does_not_scan(watched: Watched) -> None:
    watched.push(1.0, held_s=2.5)
    watched.push(5.0)
    watched.run(6.0)
    assert watched.scans == 1
    assert any("Held 2 s, no scan. Room for" in line and "Battery 50%" in line for line in watched.said)
    assert any("sshd's public key cannot be read" in line for line in watched.said)


class Hand:
    """An operator who presses what a calibration asks for and leaves the button to the test."""

    def __init__(self, wired: Wired) -> None:
        self._bench, self._operator = wired.bench, wired.hardware.operator

    def ask(self, request: OperatorRequest) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(self._bench, "schedule_button", lambda _press: None)
            self._operator.ask(request)


@pytest.fixture
def calibrating(bench: Bench, tmp_path: Path) -> Iterator[Watched]:
    """A new board whose button has been held twice."""
    wired = wired_hardware(bench, "PCA9955B")
    board = dataclasses.replace(wired, hardware=dataclasses.replace(wired.hardware, operator=Hand(wired)))
    watched = Watched(board, BundleStore(tmp_path / "new", bench.clock))
    with watched.instrument:
        for at_s in (0.1, 2.6):
            watched.push(at_s, held_s=2.1)
        watched.run(5.0)
        assert watched.instrument.state.activity == "calibrating"
        assert watched.said[-1] == "Touch nothing with the gel, then push the button."
        yield watched


def test_held_twice_the_button_alone_calibrates_and_scans(calibrating: Watched) -> None:
    shown: list[str] = []
    show = calibrating.wired.hardware.indicator.show
    calibrating.wired.hardware.indicator.show = lambda cue: (shown.append(cue), show(cue))[1]  # type: ignore[method-assign]
    while calibrating.instrument.state.activity == "calibrating":
        calibrating.push(0.1)
        calibrating.run(0.6)
    assert any("passed and is in force" in line for line in calibrating.said)
    assert shown[:3] == ["busy", "may lift", "good"]
    assert shown[-3:] == ["busy", "may lift", "calibration"]
    assert shown.count("may lift") >= 13
    calibrating.push(0.5)
    calibrating.run(2.0)
    assert calibrating.scans == 1


def test_a_calibration_by_the_button_is_given_up_by_a_long_push(calibrating: Watched) -> None:
    calibrating.push(0.5, held_s=2.5)
    calibrating.run(4.0)
    assert calibrating.instrument.state.activity == "ready"
    assert "The calibration was stopped; the one before stays in force." in calibrating.said
    assert calibrating.scans == 0


def test_a_calibration_that_nobody_goes_on_with_ends(calibrating: Watched) -> None:
    calibrating.wired.bench.clock.sleep(PATIENCE_S - 10.0)
    calibrating.run(1.0)
    assert calibrating.instrument.state.activity == "calibrating"
    calibrating.wired.bench.clock.sleep(15.0)
    calibrating.run(1.0)
    assert calibrating.instrument.state.activity == "ready"
    assert any("Nobody pushed for three minutes" in line for line in calibrating.said)


def test_long_pushes_far_apart_begin_no_calibration(watched: Watched) -> None:
    for _ in range(2):
        watched.push(0.1, held_s=2.1)
        watched.run(2.5)
        watched.wired.bench.clock.sleep(10.0)
    assert watched.instrument.state.activity == "ready"
    assert watched.instrument.state.guide is None


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
    watched.run(0.3)
    mend = fault(watched.wired)
    watched.push(0.2)
    watched.run(60.0, lambda: any(sentence in line for line in watched.said))
    assert watched.scans == 0
    mend()
    watched.push(2.0)
    watched.run(3.5)
    assert watched.scans == 1
    assert watched.instrument.state.activity == "ready"
    assert sum(sentence in line for line in watched.said) <= 2


def test_lights_that_could_not_be_switched_off_are_dark_a_second_after_the_bus_is_back(watched: Watched) -> None:
    wired = watched.wired
    watched.run(0.3)
    assert any(wired.leds.currents_ma())
    wired.wire.faults.unplugged.add(LIGHTS_AT)
    watched.push(0.2)
    watched.run(60.0, lambda: watched.instrument.state.activity == "out of order")
    wired.wire.faults.unplugged.clear()
    watched.instrument.power_off()
    watched.run(1.1)
    assert not any(wired.leds.currents_ma())
    assert watched.scans == 0


def test_a_failing_indicator_costs_no_scan_and_does_not_keep_the_instrument_from_starting(
    bench: Bench, calibrated: BundleStore
) -> None:
    def fail(_on: bool) -> None:
        raise IndicatorError("the indicator on line 27 cannot be driven")

    wired = wired_hardware(bench, "PCA9955B")
    broken = RhythmIndicator(fail, lambda: fail(False), wired.bench.clock)
    board = dataclasses.replace(wired, hardware=dataclasses.replace(wired.hardware, indicator=broken))
    watched = Watched(board, calibrated)
    with watched.instrument:
        watched.push(1.0)
        watched.run(2.0)
    assert watched.scans == 1
    assert not any(wired.leds.currents_ma())
    blamed = [finding.part for finding in selftest(board.hardware) if finding.state == "failed"]
    assert blamed == ["indicator"]


def test_chatter_on_the_line_scans_nothing(watched: Watched) -> None:
    now_ns = watched.wired.bench.clock.monotonic_ns()
    watched.wired.line.chatter([Edge(now_ns + n * 2_000_000, n % 2 == 0) for n in range(1, 400)])
    watched.run(2.0)
    assert watched.scans == 0
