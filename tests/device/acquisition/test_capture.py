import dataclasses
from collections.abc import Mapping

import msgspec
import pytest
from emulated_board import Chip, emulated_hardware

from device.acquisition.capture import (
    GAIN_MARGIN,
    MAX_FRAMES,
    MAX_RESTARTS,
    CaptureSettings,
    capture,
    capture_with_faults,
)
from device.bundles.fingerprint import Fingerprint, SettingsRecord
from device.errors import FrameError, FrameNotConfirmed
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.errors import FrameTimeout, LightError
from hal.frame import CameraSettings
from hal.hardware import Hardware
from hal.interfaces import LightFault
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.camera import SENSORS, granted
from hal.simulator.hardware import twin_hardware


def test_the_frame_shows_what_was_asked_and_began_in_steady_light(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        asked = CameraSettings(2.0 * bench.profile.camera.exposure_us, 1.0)
        began_ns = hardware.clock.monotonic_ns()
        frame = capture(hardware, CaptureSettings(asked, bench.profile.currents_ma))
    assert frame.granted.exposure_us == pytest.approx(asked.exposure_us, rel=0.02)
    assert frame.sensor_timestamp_ns > began_ns
    assert frame.mosaic.mean() > bench.profile.sensor.black_level_dn + 100


def test_the_lights_are_dark_afterwards(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        capture(hardware, CaptureSettings.of_board(hardware))
        assert not any(bench.currents_ma.values())


def test_controls_that_never_arrive_are_named_and_the_lights_go_dark(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        capture(hardware, CaptureSettings.of_board(hardware))
        bench.faults.controls_ignored = True
        other = CameraSettings(3.0 * bench.profile.camera.exposure_us, 1.0)
        with pytest.raises(FrameNotConfirmed, match=f"none of {MAX_FRAMES} frames .* press again"):
            capture(hardware, CaptureSettings(other, bench.profile.currents_ma))
        assert not any(bench.currents_ma.values())
        bench.faults.controls_ignored = False
        assert capture(hardware, CaptureSettings.of_board(hardware)).shape == hardware.camera.shape


def test_a_stalled_camera_leaves_the_lights_dark(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        bench.faults.camera_stalled = True
        with pytest.raises(FrameTimeout):
            capture(hardware, CaptureSettings.of_board(hardware))
        assert not any(bench.currents_ma.values())


def test_a_stalled_camera_is_opened_anew_in_the_dark_and_the_capture_goes_on(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    lit_at_opening: list[bool] = []
    opened = emulated.cameras.__class__.__call__

    class Watched(emulated.cameras.__class__):  # type: ignore[misc, name-defined]
        def __call__(self, camera_num: int) -> object:
            lit_at_opening.append(any(emulated.leds.currents_ma()))
            return opened(self, camera_num)

    emulated.cameras.__class__ = Watched
    emulated.cameras.faults.stalled_openings = MAX_RESTARTS
    with emulated.hardware as hardware:
        frame = capture(hardware, CaptureSettings.of_board(hardware))
        assert frame.mosaic.mean() > frame.black_level_dn + 100
        assert lit_at_opening == [False] * (1 + MAX_RESTARTS)
        assert not any(emulated.leds.currents_ma())
        emulated.bench.faults.camera_stalled = True
        with pytest.raises(FrameTimeout, match=f"even after {MAX_RESTARTS} restarts: check its ribbon"):
            capture(hardware, CaptureSettings.of_board(hardware))
    assert not any(lit_at_opening)


@pytest.mark.parametrize("driver", ["twin", "PCA9955B"])
def test_a_calibrations_plan_is_granted_the_same_exposure_as_often_as_it_is_asked(
    bench: SimulatedScene, driver: str
) -> None:
    board = twin_hardware(bench) if driver == "twin" else emulated_hardware(bench, "PCA9955B").hardware
    with board as hardware:
        plan = CaptureSettings.of_board(hardware)
        reference = capture(hardware, plan)
        fingerprint = Fingerprint.of(hardware.profile, reference.granted, plan.currents_ma)
        for asked in (SettingsRecord.of(plan.settings), None):
            again = CaptureSettings.of_calibration(hardware, fingerprint, asked)
            for _ in range(3):
                assert capture(hardware, again).granted == reference.granted


@pytest.mark.parametrize("name", ["pi5-imx296", "pi4-imx477", "pi4-imx477-binned", "zero2w-imx708"])
def test_what_a_sensor_granted_it_grants_again(small_twin: BoardProfile, name: str) -> None:
    """Metadata state gains in single precision, and every second one would be cut to the code before it."""
    sensor = load_board_profile(name).sensor
    controls = SENSORS[sensor.model]
    gains = [controls.gain(code) for code in range(controls.codes[0], controls.codes[1] + 1)]
    lost = [gain for gain in gains if controls.granted_gain(gain) != gain]
    own = msgspec.structs.replace(small_twin.sensor, model=sensor.model, exposure_step_us=sensor.exposure_step_us)
    with twin_hardware(build(msgspec.structs.replace(small_twin, sensor=own), VirtualClock())) as hardware:
        plan = CaptureSettings.of_board(hardware)
        for steps in range(200, 240):
            asked = CameraSettings(steps * sensor.exposure_step_us, lost[steps % len(lost)] * (1.0 + GAIN_MARGIN))
            found = granted(sensor.model, asked, sensor.exposure_step_us)
            fingerprint = Fingerprint.of(hardware.profile, found, plan.currents_ma)
            again = CaptureSettings.of_calibration(hardware, fingerprint).settings
            assert granted(sensor.model, again, sensor.exposure_step_us) == found
        assert capture(hardware, CaptureSettings.of_calibration(hardware, fingerprint)).granted == found
    assert [controls.granted_gain(gain * (1.0 + GAIN_MARGIN)) for gain in gains] == gains


def test_a_frame_one_step_off_the_calibration_is_not_taken(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        plan = CaptureSettings.of_board(hardware)
        granted = capture(hardware, plan).granted
        step_us = bench.profile.sensor.exposure_step_us
        for off in (-step_us, step_us):
            other = CameraSettings(granted.exposure_us + off, granted.analogue_gain)
            with pytest.raises(FrameNotConfirmed, match=f"showed exposure {other.exposure_us:g} µs"):
                capture(hardware, dataclasses.replace(plan, granted=other))
        louder = CameraSettings(granted.exposure_us, 1.01 * granted.analogue_gain)
        with pytest.raises(FrameNotConfirmed):
            capture(hardware, dataclasses.replace(plan, granted=louder))


@pytest.mark.parametrize("chip", ["PCA9955B", "TLC59116"])
def test_driver_faults_during_the_exposure_come_with_the_frame(bench: SimulatedScene, chip: Chip) -> None:
    emulated = emulated_hardware(bench, chip)
    with emulated.hardware as hardware:
        plan = CaptureSettings.of_board(hardware)
        assert capture_with_faults(hardware, plan).light_faults == ()
        emulated.leds.open_channels.add(4)
        assert capture_with_faults(hardware, plan).light_faults == (LightFault("green", "open"),)
        emulated.leds.open_channels.clear()
        assert capture_with_faults(hardware, plan).light_faults == ()
        assert not any(emulated.leds.currents_ma())


def test_a_driver_that_cannot_be_asked_for_faults_costs_no_frame(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    with emulated.hardware as hardware:

        def mute() -> tuple[LightFault, ...]:
            raise LightError("silent")

        hardware.lights.faults = mute  # type: ignore[method-assign]
        captured = capture_with_faults(hardware, CaptureSettings.of_board(hardware))
        assert captured.light_faults is None
        assert captured.frame.mosaic.mean() > captured.frame.black_level_dn + 100


@pytest.mark.parametrize(
    ("changed", "key"),
    [({"rows": 270}, "sensor.rows"), ({"bayer_order": "BGGR"}, "bayer_order"), ({"white_level_dn": 1023.0}, "white_")],
)
def test_a_frame_of_another_sensor_is_refused_by_name(
    hardware: Hardware, bench: SimulatedScene, changed: dict[str, object], key: str
) -> None:
    sensor = msgspec.structs.replace(hardware.profile.sensor, **changed)
    other = dataclasses.replace(hardware, profile=msgspec.structs.replace(hardware.profile, sensor=sensor))
    with other, pytest.raises(FrameError, match=f"but the board profile says .*{key}"):
        capture(other, CaptureSettings.of_board(other))
    assert not any(bench.currents_ma.values())


def test_an_order_as_granted_is_taken_but_not_another_than_the_calibrations(bench: SimulatedScene) -> None:
    sensor = msgspec.structs.replace(bench.profile.sensor, bayer_order="as granted")
    left_open = msgspec.structs.replace(bench.profile, sensor=sensor)
    board = emulated_hardware(build(left_open, bench.clock), "PCA9955B")
    board.cameras.faults.raw_format = "SBGGR12"
    with board.hardware as hardware:
        plan = CaptureSettings.of_board(hardware)
        assert capture(hardware, plan).bayer_order == "BGGR"
        assert capture(hardware, dataclasses.replace(plan, bayer_order="BGGR")).bayer_order == "BGGR"
        with pytest.raises(FrameError, match=r"delivers BGGR but its calibration was made with RGGB.*calibrate"):
            capture(hardware, dataclasses.replace(plan, bayer_order="RGGB"))


def test_a_plan_names_the_currents_that_the_driver_grants(bench: SimulatedScene) -> None:
    hardware = emulated_hardware(bench, "PCA9955B").hardware
    plan = CaptureSettings.of_board(hardware)
    assert plan.currents_ma != hardware.profile.currents_ma
    assert plan.currents_ma == hardware.lights.granted_ma(plan.currents_ma)


def test_a_bus_that_dies_while_lights_are_on_is_reported_and_dark_by_the_line(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    with emulated.hardware as hardware:
        plan = CaptureSettings.of_board(hardware)
        switch_on = hardware.lights.switch_on

        def switch_on_and_lose_the_bus(currents_ma: Mapping[str, float]) -> None:
            switch_on(currents_ma)
            emulated.wire.faults.stuck = True

        hardware.lights.switch_on = switch_on_and_lose_the_bus  # type: ignore[method-assign]
        with pytest.raises(LightError, match="switching all channels off"):
            capture(hardware, plan)
        # The chip's registers still say "on", and its output enable makes dark.
        assert any(emulated.leds.driven_ma())
        assert not any(emulated.leds.currents_ma())
        hardware.lights.switch_on = switch_on  # type: ignore[method-assign]
        emulated.wire.faults.stuck = False
        assert capture(hardware, plan).granted.exposure_us > 0.0
        assert not any(emulated.leds.currents_ma())


def test_silent_lights_are_an_error_of_the_lights(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        bench.faults.lights_silent = True
        with pytest.raises(LightError):
            capture(hardware, CaptureSettings.of_board(hardware))
        bench.faults.lights_silent = False
