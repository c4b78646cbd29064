"""The handheld's whole path on the twin: guided calibration, then presses of the button."""

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tifffile
from emulated_board import GAUGE_AT, Chip, emulated_hardware

import device.acquisition.scanner
from device.acquisition.calibrate import calibrate
from device.acquisition.capture import CaptureSettings
from device.acquisition.guided_calibration import press_places
from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations, LightFaultRecord
from device.errors import CalibrationError, CalibrationMismatch, NoCalibration, StoreError
from device.inverse_map.model import read_model
from device.quick_look.solver import HEIGHT_FILE, PICTURE_FILE
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.interfaces import LiftOff, LightFault, MayLift, OperatorRequest, PressBall, PressObject
from hal.simulator.bench import SimulatedScene, build

BALL_RADIUS_MM = 3.0


class Absent:
    """An operator who pushes the button without pressing anything."""

    def __init__(self, hardware: Hardware) -> None:
        self._operator = hardware.operator
        self.asked: list[OperatorRequest] = []

    def ask(self, request: OperatorRequest) -> None:
        self.asked.append(request)
        self._operator.ask(LiftOff())


def press(hardware: Hardware, name: str) -> None:
    hardware.operator.ask(PressObject(name))
    hardware.button.wait_for_press(None)


def test_scans_keep_to_the_order_of_a_calibration_as_granted(bench: SimulatedScene, store: BundleStore) -> None:
    sensor = msgspec.structs.replace(bench.profile.sensor, bayer_order="as granted")
    board = emulated_hardware(build(msgspec.structs.replace(bench.profile, sensor=sensor), bench.clock), "PCA9955B")
    with board.hardware as hardware:
        bundle = calibrate(hardware, store, BALL_RADIUS_MM, lambda _: None).bundle
        assert bundle.record.fingerprint.channel_order == "as granted"
        assert Scanner(hardware, store).plan.bayer_order == bundle.reference().bayer_order == "RGGB"


def test_calibration_finds_every_ball_and_becomes_active(hardware: Hardware, store: BundleStore) -> None:
    printed: list[str] = []
    with hardware:
        board = CaptureSettings.of_board(hardware)
        currents_ma = {name: 0.9 * current for name, current in board.currents_ma.items()}
        plan = CaptureSettings(board.settings, currents_ma)
        outcome = calibrate(hardware, store, BALL_RADIUS_MM, printed.append, plan)
    assert outcome.fit.kept.sum() >= len(press_places()) - 1  # noise alone may make one doubtful at this size
    assert len(outcome.fit.balls) == len(press_places())
    assert outcome.fit.held_out_deg is not None
    assert outcome.fit.held_out_deg < 3.0
    assert any("far left, at the top" in line for line in printed)
    bundle = store.active_calibration()
    bundle.verify()
    assert bundle.calibration_id == outcome.bundle.calibration_id
    assert len(bundle.record.presses) == len(press_places())
    assert {light.name: light.current_ma for light in bundle.record.fingerprint.lights} == currents_ma
    for colour in ("red", "green", "blue"):
        flat, peak = (bundle.record.figures[f"{what}_level_{colour}"] for what in ("flat", "brightest"))
        assert 0.1 < (flat or 0.0) < (peak or 0.0) < 1.0
    stored = read_model(bundle.path(bundle.record.model_files[0]))
    np.testing.assert_array_equal(stored.curve.coefficients, outcome.fit.map.curve.coefficients)


def test_a_button_press_becomes_a_scan_with_a_verdict_and_a_quick_look(
    hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene
) -> None:
    lifted: list[bool] = []
    with hardware:
        scanner = Scanner(hardware, calibrated)
        assert scanner.measure_lights()
        press(hardware, "sphere")
        outcome = scanner.scan(Annotations(job="test"), lambda: lifted.append(True))
        truth = bench.truth()
    bundle = outcome.bundle
    bundle.verify()
    assert lifted == [True]
    assert bundle.record.verdict.level == "good"
    assert bundle.record.annotations.job == "test"
    assert bundle.record.calibration_id == calibrated.active_calibration().calibration_id
    assert [found.scan_id for found in calibrated.scans().bundles] == [bundle.scan_id]
    height = tifffile.imread(bundle.path(HEIGHT_FILE))
    assert bundle.path(PICTURE_FILE).stat().st_size > 500
    binned = truth.z_um.reshape(136, 2, 182, 2).mean(axis=(1, 3))
    error = (height - height[:10].mean()) - (binned - binned[:10].mean())
    assert np.sqrt((error**2).mean()) < 0.04 * np.ptp(binned)


def test_a_scan_is_taken_with_the_settings_of_its_calibration_and_notes_the_supply(
    hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene
) -> None:
    lights = tuple(msgspec.structs.replace(light, current_ma=0.5) for light in hardware.profile.lights)
    weaker = msgspec.structs.replace(hardware.profile, lights=lights)
    bench.faults.under_voltage = True
    with dataclasses.replace(hardware, profile=weaker) as board:
        record = Scanner(board, calibrated).scan(Annotations()).bundle.record
    assert record.currents_ma == {"red": 6.4, "green": 4.9, "blue": 4.9}
    assert record.power.under_voltage is True
    assert record.power.battery_share is None


@pytest.mark.parametrize("name", ["sphere", "coin", "texture"])
@pytest.mark.parametrize("light", ["red", "green", "blue"])
def test_a_dead_light_is_a_retake_that_names_it_with_and_without_a_flag(
    hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene, light: str, name: str
) -> None:
    with hardware:
        scanner = Scanner(hardware, calibrated)
        scanner.measure_lights()
        press(hardware, name)
        sound = scanner.scan(Annotations(), lambda: hardware.operator.ask(MayLift())).bundle.record
        press(hardware, name)
        bench.faults.open_lights.add(light)
        flagged = scanner.scan(Annotations()).bundle.record
        hardware.lights.faults = lambda: ()  # type: ignore[method-assign]
        seen = scanner.scan(Annotations()).bundle.record
    assert sound.verdict.level == "good"
    assert sound.light_faults == ()
    assert flagged.verdict.level == seen.verdict.level == "retake"
    assert flagged.light_faults == (LightFaultRecord(light=light, kind="open"),)
    assert f"light {light} is at" in seen.verdict.reason
    assert "and the driver reports open" in flagged.verdict.reason
    others = [f"border_level_{other}" for other in ("red", "green", "blue") if other != light]
    assert all((seen.verdict.figures[other] or 0.0) > 0.7 for other in others)


@pytest.mark.parametrize("chip", ["PCA9955B", "TLC59116"])
@pytest.mark.parametrize("how", ["open_channels", "shorted_channels"])
def test_one_led_of_two_that_is_open_or_shorted_is_a_retake(
    bench: SimulatedScene, calibrated: BundleStore, chip: Chip, how: str
) -> None:
    emulated = emulated_hardware(bench, chip)
    with emulated.hardware as board:
        scanner = Scanner(board, calibrated)
        assert scanner.scan(Annotations()).bundle.record.verdict.level != "retake"
        getattr(emulated.leds, how).add(4)
        verdict = scanner.scan(Annotations()).bundle.record.verdict
    assert verdict.level == "retake"
    assert "light green is at" in verdict.reason
    assert "red" not in verdict.reason


def test_a_flag_that_the_camera_contradicts_is_doubted(hardware: Hardware, calibrated: BundleStore) -> None:
    hardware.lights.faults = lambda: (LightFault("blue", "short"),)  # type: ignore[method-assign]
    with hardware:
        press(hardware, "sphere")
        record = Scanner(hardware, calibrated).scan(Annotations()).bundle.record
    assert record.verdict.level == "doubtful"
    assert "% of its calibrated level and the driver reports short: run `retroscan selftest`" in record.verdict.reason
    assert record.light_faults == (LightFaultRecord(light="blue", kind="short"),)


def test_a_dead_light_cannot_be_calibrated_with_and_is_named(
    hardware: Hardware, store: BundleStore, bench: SimulatedScene
) -> None:
    bench.faults.open_lights.add("red")
    with hardware, pytest.raises(CalibrationError, match=r"light red is hardly visible \(the driver reports open\)"):
        calibrate(hardware, store, BALL_RADIUS_MM, lambda _: None)
    assert store.calibrations().bundles == ()


def test_a_scan_is_granted_the_very_exposure_of_its_calibration(hardware: Hardware, calibrated: BundleStore) -> None:
    calibration = calibrated.active_calibration().record
    with hardware:
        record = Scanner(hardware, calibrated).scan(Annotations()).bundle.record
    assert record.granted.exposure_us == calibration.fingerprint.exposure_us
    assert calibration.asked is not None
    assert calibration.asked.exposure_us > calibration.fingerprint.exposure_us
    assert record.asked == calibration.asked


def test_a_supply_that_sags_under_the_lights_or_under_the_work_is_noted(
    bench: SimulatedScene, calibrated: BundleStore
) -> None:
    for dip in (0, 1):
        emulated = emulated_hardware(bench, "PCA9955B")
        readings = ["0", "0"]
        readings[dip] = "50001"
        emulated.hardware.power._throttled_text = iter(readings).__next__  # type: ignore[attr-defined]
        with emulated.hardware as board:
            power = Scanner(board, calibrated).scan(Annotations()).bundle.record.power
        assert (power.under_voltage, power.was_under_voltage, power.throttled) == (True, True, False)


def test_granted_currents_are_recorded_and_a_dead_gauge_costs_no_scan(
    bench: SimulatedScene, calibrated: BundleStore
) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    emulated.firmware.throttled = "50005"
    with emulated.hardware as board:
        scanner = Scanner(board, calibrated)
        full = scanner.scan(Annotations()).bundle.record
        emulated.wire.faults.unplugged.add(GAUGE_AT)
        unmeasured = scanner.scan(Annotations()).bundle.record
    driver = emulated.hardware.profile.light_driver
    assert driver is not None
    steps = [current * driver.reference_ohm / 225.0 for current in full.currents_ma.values()]
    assert steps == pytest.approx([round(step) for step in steps])
    assert full.currents_ma == pytest.approx({"red": 6.4, "green": 4.9, "blue": 4.9}, rel=0.02)
    assert full.power.battery_share == 0.5
    assert unmeasured.power.battery_share is None
    assert unmeasured.power.under_voltage is True


def test_nothing_pressed_is_doubted_and_no_light_is_a_retake(
    hardware: Hardware, calibrated: BundleStore, bench: SimulatedScene
) -> None:
    with hardware:
        scanner = Scanner(hardware, calibrated)
        hardware.operator.ask(LiftOff())
        hardware.button.wait_for_press(None)
        assert scanner.scan(Annotations()).bundle.record.verdict.level == "doubtful"
        bench.faults.lights_broken = True
        verdict = scanner.scan(Annotations()).bundle.record.verdict
    assert verdict.level == "retake"
    assert "black" in verdict.reason


def test_scanning_without_a_calibration_is_refused(hardware: Hardware, store: BundleStore) -> None:
    with hardware, pytest.raises(NoCalibration, match="retroscan calibrate"):
        Scanner(hardware, store)


def test_a_calibration_of_another_gel_or_light_is_refused_by_name(hardware: Hardware, calibrated: BundleStore) -> None:
    gel = msgspec.structs.replace(hardware.profile.gel, id="other-gel")
    other_gel = dataclasses.replace(hardware, profile=msgspec.structs.replace(hardware.profile, gel=gel))
    with pytest.raises(CalibrationMismatch, match=r"gel \(twin-gel, not other-gel\)"):
        Scanner(other_gel, calibrated)
    red, green, blue = hardware.profile.lights
    moved = msgspec.structs.replace(green, position_mm=(-18.0, 12.0, 12.5))
    lights = msgspec.structs.replace(hardware.profile, lights=(red, moved, blue))
    with pytest.raises(CalibrationMismatch, match="position of light green"):
        Scanner(dataclasses.replace(hardware, profile=lights), calibrated)


def test_a_calibration_without_balls_is_refused_and_nothing_is_published(
    hardware: Hardware, store: BundleStore
) -> None:
    absent = Absent(hardware)
    lazy = dataclasses.replace(hardware, operator=absent)
    with lazy, pytest.raises(CalibrationError, match="only 0 of 12 presses showed a usable ball"):
        calibrate(lazy, store, BALL_RADIUS_MM, lambda _: None)
    assert sum(isinstance(request, PressBall) for request in absent.asked) == 3 * len(press_places())
    assert store.calibrations().bundles == ()


def test_a_full_store_refuses_before_the_press(
    hardware: Hardware, calibrated: BundleStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BundleStore, "scans_left", lambda _store, _size: 0)
    with hardware, pytest.raises(StoreError, match="no room for another scan"):
        Scanner(hardware, calibrated).scan(Annotations())
    assert calibrated.scans().bundles == ()


def test_a_disk_that_fills_while_writing_leaves_no_half_scan(
    hardware: Hardware, calibrated: BundleStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, _frame: object) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(device.acquisition.scanner, "write_raw", refuse)
    with hardware:
        scanner = Scanner(hardware, calibrated)
        with pytest.raises(StoreError, match="No space left"):
            scanner.scan(Annotations())
    assert calibrated.scans().bundles == ()
    assert list((calibrated.root / "scans").iterdir()) == []
