"""A sensor on USB: calibrated and scanned with lights that are always on, exposed by itself, unplugged in between."""

from pathlib import Path

import msgspec
import pytest
from fake_v4l2 import FakeVideo, usb_sensor

from device.acquisition.auto_exposure import AIMED_LEVEL, auto_exposure
from device.acquisition.calibrate import calibrate
from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.precise_capture import capture_precisely
from device.acquisition.scanner import Scanner
from device.acquisition.selftest import selftest
from device.bundles.scan import Annotations
from device.errors import CalibrationError, CaptureModeRefused
from device.instrument.events import Failed
from device.instrument.instrument import Instrument
from device.store.choices import SETTINGS, Settings, read_settings
from device.store.store import BundleStore
from hal.errors import CameraError
from hal.hardware import Hardware
from hal.interfaces import MayLift, PressObject
from hal.simulator.bench import SimulatedScene


@pytest.fixture
def sensor(bench: SimulatedScene) -> tuple[Hardware, FakeVideo]:
    return usb_sensor(bench)


def test_it_calibrates_and_scans_and_knows_its_lights(sensor: tuple[Hardware, FakeVideo], tmp_path: Path) -> None:
    hardware, video = sensor
    store = BundleStore(tmp_path / "store", hardware.clock, boot_id="b0075e1f")
    with hardware:
        fit = calibrate(hardware, store, 3.0, lambda _: None).fit
        assert fit.held_out_deg < 2.5
        scanner = Scanner(hardware, store)

        def may_lift() -> None:
            hardware.operator.ask(MayLift())

        assert scanner.measure_lights()
        hardware.operator.ask(PressObject("coin"))
        assert hardware.button.wait_for_push(None) is not None
        outcome = scanner.scan(Annotations(), may_lift)
        assert outcome.bundle.record.verdict.level == "good", outcome.bundle.record.verdict.reason
        assert outcome.bundle.record.granted.exposure_us == 2000.0
        assert outcome.quick_look is not None
        video.bench.drive({**hardware.profile.currents_ma, "green": 0.6 * hardware.profile.currents_ma["green"]})
        hardware.operator.ask(PressObject("coin"))
        assert hardware.button.wait_for_push(None) is not None
        verdict = scanner.scan(Annotations(), may_lift).bundle.record.verdict
        assert verdict.level == "retake"
        assert "light green" in verdict.reason


def test_a_sensor_that_is_unplugged_costs_a_press_and_no_more(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, video = sensor
    plan = CaptureSettings.of_board(hardware)
    with hardware:
        capture(hardware, plan)
        video.unplug()
        for _ in range(2):
            with pytest.raises(CameraError, match="plug it in"):
                capture(hardware, plan)
        video.plug_in()
        assert capture(hardware, plan).granted == plan.settings


@pytest.mark.parametrize("switched_by_zoom", [False, True])
def test_auto_exposure_finds_the_level(bench: SimulatedScene, switched_by_zoom: bool) -> None:
    hardware, _ = usb_sensor(bench, switched_by_zoom)
    with hardware:
        found = auto_exposure(hardware, 3.0, lambda _: None)
    assert max(found.predicted) == pytest.approx(AIMED_LEVEL, abs=0.1)
    if not switched_by_zoom:
        assert found.plan.currents_ma == hardware.profile.currents_ma


def test_lights_too_bright_for_any_exposure_are_said(bench: SimulatedScene) -> None:
    glaring = msgspec.structs.replace(bench.profile.twin, yield_e_per_ma_ms=50_000.0)
    world = SimulatedScene(msgspec.structs.replace(bench.profile, twin=glaring), bench.clock, 1)
    hardware, _ = usb_sensor(world)
    with hardware, pytest.raises(CalibrationError, match="the frame saturates even with the light divided by 16"):
        auto_exposure(hardware, 3.0, lambda _: None)


def test_the_selftest_tests_each_channel(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, video = sensor
    findings = {finding.part: finding for finding in selftest(hardware)}
    assert {finding.state for finding in findings.values()} <= {"ok", "skipped"}
    assert findings["darkness"].sentence == "the lights of this sensor are always on"
    assert "always on and cannot be switched" in findings["light driver"].sentence
    assert "all lights on" in findings["light blue"].sentence
    video.bench.drive({})
    assert {f.state for f in selftest(hardware) if f.part.startswith("light ") and f.part != "light driver"} == {
        "failed"
    }


def test_presses_light_by_light_are_refused_where_lights_are_always_on(
    sensor: tuple[Hardware, FakeVideo], tmp_path: Path
) -> None:
    hardware, _ = sensor
    root = tmp_path / "store"
    with Instrument(hardware, BundleStore(root, hardware.clock, boot_id="b0075e1f")) as instrument:
        instrument.set_settings(Settings(capture="average"))
        instrument.set_settings(Settings(capture="lights"))
        refused = [event.sentence for event in instrument.take_events() if isinstance(event, Failed)]
        assert any("are always on, so that no light can be seen alone" in sentence for sentence in refused)
        assert instrument.state.settings.capture == "average"
        assert read_settings(root).capture == "average"
    SETTINGS.write(root, Settings(capture="lights"))  # of another sensor, before it was changed
    again = Instrument(hardware, BundleStore(root, hardware.clock, boot_id="b0075e1f"))
    assert again.state.settings.capture == "average"
    with hardware, pytest.raises(CaptureModeRefused, match="always on"):
        capture_precisely(hardware, CaptureSettings.of_board(hardware), "lights")
