"""The instrument without a screen, on the real drivers: cues, long pushes, faults and what follows them."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from emulated_board import LIGHTS_AT, EmulatedBoard, emulated_hardware
from fake_gpio import Edge

import device.cli.instrument_commands
from device.acquisition.selftest import selftest
from device.cli.instrument_commands import run_headless
from device.cli.main import main
from device.cli.service import POWER_OFF_FILE
from device.instrument.calibration_run import IDLE_TIMEOUT_S
from device.instrument.instrument import Instrument
from device.pairing_service import PairingSetup
from device.store.store import BundleStore
from hal.drivers.gpio_lines import BlinkIndicator
from hal.errors import IndicatorError
from hal.interfaces import ButtonPress, OperatorRequest
from hal.simulator.bench import SimulatedScene

SECOND = 1_000_000_000


class Board:
    """A board that serves its button without a screen."""

    def __init__(self, emulated: EmulatedBoard, store: BundleStore) -> None:
        self.emulated = emulated
        self.store = store
        self.printed: list[str] = []
        setup = PairingSetup(host_key=store.root / "none")
        self.instrument = Instrument(emulated.hardware, store, pairing=setup)

    @property
    def scans(self) -> int:
        return len(self.store.scans().bundles)

    def push(self, at_s: float, held_s: float = 0.1) -> None:
        now_ns = self.emulated.bench.clock.monotonic_ns()
        self.emulated.bench.schedule_button(ButtonPress(now_ns + round(at_s * SECOND), held_s))

    def run(self, for_s: float, until: Callable[[], bool] = lambda: False) -> None:
        clock = self.emulated.bench.clock
        end_ns = clock.monotonic_ns() + round(for_s * SECOND)

        def print_error(what: object) -> None:
            self.printed.append(str(what))

        run_headless(
            self.instrument, self.printed.append, print_error, lambda: clock.monotonic_ns() < end_ns and not until()
        )


@pytest.fixture
def board(bench: SimulatedScene, calibrated: BundleStore) -> Iterator[Board]:
    emulated = emulated_hardware(bench, "PCA9955B")
    board = Board(emulated, calibrated)
    with board.instrument:
        yield board
    assert not any(emulated.leds.currents_ma())
    assert emulated.cameras.opened == emulated.cameras.held_requests == emulated.wire.opened == 0


def test_every_push_is_one_scan_with_its_cues(board: Board) -> None:
    shown: list[str] = []
    show = board.emulated.hardware.indicator.show
    board.emulated.hardware.indicator.show = lambda cue: (shown.append(cue), show(cue))[1]  # type: ignore[method-assign]
    board.push(1.0)
    board.push(2.5)
    board.run(4.0)
    assert board.scans == 2
    assert shown == ["busy", "may lift", "doubtful", "busy", "may lift", "doubtful"]
    assert sum(line.startswith("doubtful: hardly any contact") for line in board.printed) == 2


@pytest.mark.parametrize("held_s", [0.03, 0.5, 1.8])
def test_cue_and_frame_follow_the_push_and_not_the_release(board: Board, held_s: float) -> None:
    clock = board.emulated.bench.clock
    shown: dict[str, int] = {}
    show = board.emulated.hardware.indicator.show
    board.emulated.hardware.indicator.show = lambda cue: (  # type: ignore[method-assign]
        shown.setdefault(cue, clock.monotonic_ns()),
        show(cue),
    )[1]
    board.push(1.0, held_s)
    pushed_ns = clock.monotonic_ns() + SECOND
    board.run(1.5 + held_s)
    assert 0 < shown["busy"] - pushed_ns <= 0.1 * SECOND
    assert shown["may lift"] - pushed_ns <= 0.5 * SECOND
    assert board.scans == 1


def test_without_a_calibration_it_serves_and_refuses_every_push_with_its_cue(
    bench: SimulatedScene, tmp_path: Path
) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    board = Board(emulated, BundleStore(tmp_path / "new", bench.clock))
    shown: list[str] = []
    with board.instrument:
        show = emulated.hardware.indicator.show
        emulated.hardware.indicator.show = lambda cue: (shown.append(cue), show(cue))[1]  # type: ignore[method-assign]
        board.push(1.0)
        board.run(2.0)
    assert (shown, board.scans) == (["refused: calibration"], 0)
    assert [line for line in board.printed if "retroscan calibrate" in line] == [board.printed[0], board.printed[-1]]


def test_it_reports_ready_once_every_part_answers(bench: SimulatedScene, calibrated: BundleStore) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    mend = _lights_unplugged(emulated)
    board = Board(emulated, calibrated)
    with board.instrument:
        board.run(3.0)
        assert [line[:13] for line in board.printed] == ["no chip answe"]
        mend()
        board.run(3.0)
        assert [line[:5] for line in board.printed[1:]] == ["Ready", "all p"]


def test_a_long_push_reports_the_status_and_does_not_scan(board: Board) -> None:
    board.push(1.0, held_s=2.5)
    board.push(5.0)
    board.run(6.0)
    assert board.scans == 1
    assert any("Held 2 s, no scan. Room for" in line and "Battery 50%" in line for line in board.printed)
    assert any("sshd's public key cannot be read" in line for line in board.printed)


class Hand:
    """An operator who presses what a calibration asks for and leaves the button to the test."""

    def __init__(self, emulated: EmulatedBoard) -> None:
        self._bench, self._operator = emulated.bench, emulated.hardware.operator

    def ask(self, request: OperatorRequest) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(self._bench, "schedule_button", lambda _press: None)
            self._operator.ask(request)


@pytest.fixture
def calibrating(bench: SimulatedScene, tmp_path: Path) -> Iterator[Board]:
    """A new board whose button has been held twice."""
    emulated = emulated_hardware(bench, "PCA9955B")
    emulated = dataclasses.replace(emulated, hardware=dataclasses.replace(emulated.hardware, operator=Hand(emulated)))
    board = Board(emulated, BundleStore(tmp_path / "new", bench.clock))
    with board.instrument:
        for at_s in (0.1, 2.6):
            board.push(at_s, held_s=2.1)
        board.run(5.0)
        assert board.instrument.state.activity == "calibrating"
        assert board.printed[-1] == "Touch nothing with the gel, then push the button."
        yield board


def test_held_twice_the_button_alone_calibrates_and_scans(calibrating: Board) -> None:
    shown: list[str] = []
    show = calibrating.emulated.hardware.indicator.show
    calibrating.emulated.hardware.indicator.show = lambda cue: (shown.append(cue), show(cue))[1]  # type: ignore[method-assign]
    while calibrating.instrument.state.activity == "calibrating":
        calibrating.push(0.1)
        calibrating.run(0.6)
    assert any("passed and is active" in line for line in calibrating.printed)
    assert shown[:3] == ["busy", "may lift", "good"]
    assert shown[-3:] == ["busy", "may lift", "calibration"]
    assert shown.count("may lift") >= 13
    calibrating.emulated.bench.place(None)
    calibrating.push(0.5)
    calibrating.run(2.0)
    assert calibrating.scans == 1


def test_a_long_push_stops_a_calibration_by_the_button(calibrating: Board) -> None:
    calibrating.push(0.5, held_s=2.5)
    calibrating.run(4.0)
    assert calibrating.instrument.state.activity == "ready"
    assert "Calibration stopped; the previous one stays active." in calibrating.printed
    assert calibrating.scans == 0


def test_a_calibration_without_pushes_ends(calibrating: Board) -> None:
    calibrating.emulated.bench.clock.sleep(IDLE_TIMEOUT_S - 10.0)
    calibrating.run(1.0)
    assert calibrating.instrument.state.activity == "calibrating"
    calibrating.emulated.bench.clock.sleep(15.0)
    calibrating.run(1.0)
    assert calibrating.instrument.state.activity == "ready"
    assert any("No push for three minutes" in line for line in calibrating.printed)


def test_held_for_six_seconds_it_powers_off_once_the_scan_is_stored(board: Board) -> None:
    board.push(0.5)
    board.push(1.0, held_s=5.5)
    board.run(18.0)
    assert board.instrument.state.activity == "ready"
    board.push(0.1)
    board.push(1.0, held_s=30.0)
    board.run(15.0, until=lambda: board.instrument.state.activity == "off")
    assert board.printed[-1] == "The power may be switched off."
    assert board.scans == 2
    assert board.emulated.wire.opened == board.emulated.cameras.opened == 0


def test_the_command_then_ends_and_asks_the_system_to_power_off(
    bench: SimulatedScene, calibrated: BundleStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    monkeypatch.setattr(device.cli.instrument_commands, "open_hardware", lambda _profile, _clock: emulated.hardware)
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))

    def held(*arguments: Any) -> None:
        emulated.bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + SECOND, 30.0))
        run_headless(*arguments)

    monkeypatch.setattr(device.cli.instrument_commands, "run_headless", held)
    assert main(["--board", "twin", "--store", str(calibrated.root), "run"]) == 0
    assert (tmp_path / POWER_OFF_FILE).exists()


def test_a_button_that_stays_down_after_it_began_a_calibration_does_not_power_off(calibrating: Board) -> None:
    calibrating.push(0.5, held_s=2.5)
    calibrating.run(20.0)
    calibrating.push(0.1)
    calibrating.run(5.0)
    assert calibrating.instrument.state.activity == "ready"


def test_long_pushes_far_apart_begin_no_calibration(board: Board) -> None:
    for _ in range(2):
        board.push(0.1, held_s=2.1)
        board.run(2.5)
        board.emulated.bench.clock.sleep(10.0)
    assert board.instrument.state.activity == "ready"
    assert board.instrument.state.guide is None


def _lights_unplugged(emulated: EmulatedBoard) -> Callable[[], None]:
    emulated.wire.faults.unplugged.add(LIGHTS_AT)
    return emulated.wire.faults.unplugged.clear


def _bus_stuck(emulated: EmulatedBoard) -> Callable[[], None]:
    emulated.wire.faults.stuck = True
    return lambda: setattr(emulated.wire.faults, "stuck", False)


def _camera_stalls(emulated: EmulatedBoard) -> Callable[[], None]:
    emulated.bench.faults.camera_stalled = True
    return lambda: setattr(emulated.bench.faults, "camera_stalled", False)


def _camera_torn_off(emulated: EmulatedBoard) -> Callable[[], None]:
    emulated.bench.faults.camera_missing = True
    return lambda: setattr(emulated.bench.faults, "camera_missing", False)


def _wrong_size(emulated: EmulatedBoard) -> Callable[[], None]:
    emulated.cameras.faults.rows_lost = 4
    return lambda: setattr(emulated.cameras.faults, "rows_lost", 0)


def _no_exposure_stated(emulated: EmulatedBoard) -> Callable[[], None]:
    emulated.cameras.faults.without = "ExposureTime"
    return lambda: setattr(emulated.cameras.faults, "without", "")


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (_lights_unplugged, "no chip answers at 0x15 on bus 1"),
        (_bus_stuck, "bus 1 is stuck"),
        (_camera_stalls, "delivers no frame, even after 2 restarts"),
        (_camera_torn_off, "imx296@1a is not there"),
        (_wrong_size, "268 rows of 768 bytes where it granted 272"),
        (_no_exposure_stated, "frames without ExposureTime"),
    ],
)
def test_a_fault_is_reported_nothing_is_published_and_the_next_push_scans(
    board: Board, fault: Callable[[EmulatedBoard], Callable[[], None]], sentence: str
) -> None:
    board.run(0.3)
    mend = fault(board.emulated)
    board.push(0.2)
    board.run(60.0, lambda: any(sentence in line for line in board.printed))
    assert board.scans == 0
    mend()
    board.push(2.0)
    board.run(3.5)
    assert board.scans == 1
    assert board.instrument.state.activity == "ready"
    assert sum(sentence in line for line in board.printed) <= 2


def test_lights_that_could_not_be_switched_off_are_dark_a_second_after_the_bus_is_back(board: Board) -> None:
    emulated = board.emulated
    board.run(3.0, lambda: any(emulated.leds.currents_ma()))
    assert any(emulated.leds.currents_ma())
    emulated.wire.faults.unplugged.add(LIGHTS_AT)
    board.push(0.2)
    board.run(60.0, lambda: board.instrument.state.activity == "out of order")
    emulated.wire.faults.unplugged.clear()
    board.instrument.power_off()
    board.run(1.1)
    assert not any(emulated.leds.currents_ma())
    assert board.scans == 0


def test_a_failing_indicator_costs_no_scan_and_does_not_keep_the_instrument_from_starting(
    bench: SimulatedScene, calibrated: BundleStore
) -> None:
    def fail(_on: bool) -> None:
        raise IndicatorError("the indicator on line 27 cannot be driven")

    emulated = emulated_hardware(bench, "PCA9955B")
    broken = BlinkIndicator(fail, lambda: fail(False), emulated.bench.clock)
    faulty = dataclasses.replace(emulated, hardware=dataclasses.replace(emulated.hardware, indicator=broken))
    board = Board(faulty, calibrated)
    with board.instrument:
        board.push(1.0)
        board.run(2.0)
    assert board.scans == 1
    assert not any(emulated.leds.currents_ma())
    blamed = [finding.part for finding in selftest(faulty.hardware) if finding.state == "failed"]
    assert blamed == ["indicator"]


def test_chatter_on_the_line_scans_nothing(board: Board) -> None:
    now_ns = board.emulated.bench.clock.monotonic_ns()
    board.emulated.line.chatter([Edge(now_ns + n * 2_000_000, n % 2 == 0) for n in range(1, 400)])
    board.run(2.0)
    assert board.scans == 0
