import dataclasses
from collections.abc import Mapping

import msgspec
import pytest

from device.errors import FrameError, FrameNotProven
from device.fingerprint import Fingerprint
from device.scanning.capture import MOST_FRAMES, MOST_RESTARTS, CapturePlan, capture, take
from device.settings_record import SettingsRecord
from hal.errors import FrameTimeout, LightError
from hal.frame import CameraSettings
from hal.hardware import Hardware
from hal.interfaces import LightFault
from hal.twin.bench import Bench
from hal.twin.hardware import twin_hardware
from hal.twin.wired.hardware import Chip, wired_hardware


def test_the_frame_shows_what_was_asked_and_began_in_steady_light(hardware: Hardware, bench: Bench) -> None:
    with hardware:
        asked = CameraSettings(2.0 * bench.profile.camera.exposure_us, 1.0)
        began_ns = hardware.clock.monotonic_ns()
        frame = capture(hardware, CapturePlan(asked, bench.profile.currents_ma))
    assert frame.granted.exposure_us == pytest.approx(asked.exposure_us, rel=0.02)
    assert frame.sensor_timestamp_ns > began_ns
    assert frame.mosaic.mean() > bench.profile.sensor.black_level_dn + 100


def test_the_lights_are_dark_afterwards(hardware: Hardware, bench: Bench) -> None:
    with hardware:
        capture(hardware, CapturePlan.of_board(hardware))
        assert not any(bench.currents_ma.values())


def test_controls_that_never_arrive_are_named_and_the_lights_go_dark(hardware: Hardware, bench: Bench) -> None:
    with hardware:
        capture(hardware, CapturePlan.of_board(hardware))
        bench.faults.controls_ignored = True
        other = CameraSettings(3.0 * bench.profile.camera.exposure_us, 1.0)
        with pytest.raises(FrameNotProven, match=f"none of {MOST_FRAMES} frames .* press again"):
            capture(hardware, CapturePlan(other, bench.profile.currents_ma))
        assert not any(bench.currents_ma.values())
        bench.faults.controls_ignored = False
        assert capture(hardware, CapturePlan.of_board(hardware)).shape == hardware.camera.shape


def test_a_stalled_camera_leaves_the_lights_dark(hardware: Hardware, bench: Bench) -> None:
    with hardware:
        bench.faults.camera_stalled = True
        with pytest.raises(FrameTimeout):
            capture(hardware, CapturePlan.of_board(hardware))
        assert not any(bench.currents_ma.values())


def test_a_stalled_camera_is_opened_anew_in_the_dark_and_the_capture_goes_on(bench: Bench) -> None:
    wired = wired_hardware(bench, "PCA9955B")
    lit_at_opening: list[bool] = []
    opened = wired.cameras.__class__.__call__

    class Watched(wired.cameras.__class__):  # type: ignore[misc, name-defined]
        def __call__(self, camera_num: int) -> object:
            lit_at_opening.append(any(wired.leds.currents_ma()))
            return opened(self, camera_num)

    wired.cameras.__class__ = Watched
    wired.cameras.faults.stalled_openings = MOST_RESTARTS
    with wired.hardware as hardware:
        frame = capture(hardware, CapturePlan.of_board(hardware))
        assert frame.mosaic.mean() > frame.black_level_dn + 100
        assert lit_at_opening == [False] * (1 + MOST_RESTARTS)
        assert not any(wired.leds.currents_ma())
        wired.bench.faults.camera_stalled = True
        with pytest.raises(FrameTimeout, match=f"though it was restarted {MOST_RESTARTS} times: check its ribbon"):
            capture(hardware, CapturePlan.of_board(hardware))
    assert not any(lit_at_opening)


@pytest.mark.parametrize("driver", ["twin", "PCA9955B"])
def test_a_calibrations_plan_is_granted_the_same_exposure_as_often_as_it_is_asked(bench: Bench, driver: str) -> None:
    board = twin_hardware(bench) if driver == "twin" else wired_hardware(bench, "PCA9955B").hardware
    with board as hardware:
        plan = CapturePlan.of_board(hardware)
        reference = capture(hardware, plan)
        fingerprint = Fingerprint.of(hardware.profile, reference.granted, plan.currents_ma)
        for asked in (SettingsRecord.of(plan.settings), None):
            again = CapturePlan.of_calibration(hardware, fingerprint, asked)
            for _ in range(3):
                assert capture(hardware, again).granted == reference.granted


def test_a_frame_one_step_off_the_calibration_is_not_taken(hardware: Hardware, bench: Bench) -> None:
    with hardware:
        plan = CapturePlan.of_board(hardware)
        granted = capture(hardware, plan).granted
        step_us = bench.profile.sensor.exposure_step_us
        for off in (-step_us, step_us):
            other = CameraSettings(granted.exposure_us + off, granted.analogue_gain)
            with pytest.raises(FrameNotProven, match=f"showed exposure {other.exposure_us:g} µs"):
                capture(hardware, dataclasses.replace(plan, granted=other))
        louder = CameraSettings(granted.exposure_us, 1.01 * granted.analogue_gain)
        with pytest.raises(FrameNotProven):
            capture(hardware, dataclasses.replace(plan, granted=louder))


@pytest.mark.parametrize("chip", ["PCA9955B", "TLC59116"])
def test_what_the_driver_says_while_the_lights_shine_comes_with_the_frame(bench: Bench, chip: Chip) -> None:
    wired = wired_hardware(bench, chip)
    with wired.hardware as hardware:
        plan = CapturePlan.of_board(hardware)
        assert take(hardware, plan).light_faults == ()
        wired.leds.open_channels.add(4)
        assert take(hardware, plan).light_faults == (LightFault("green", "open"),)
        wired.leds.open_channels.clear()
        assert take(hardware, plan).light_faults == ()
        assert not any(wired.leds.currents_ma())


def test_a_driver_that_cannot_be_asked_for_faults_costs_no_frame(bench: Bench) -> None:
    wired = wired_hardware(bench, "PCA9955B")
    with wired.hardware as hardware:

        def mute() -> tuple[LightFault, ...]:
            raise LightError("silent")

        hardware.lights.faults = mute  # type: ignore[method-assign]
        shot = take(hardware, CapturePlan.of_board(hardware))
        assert shot.light_faults is None
        assert shot.frame.mosaic.mean() > shot.frame.black_level_dn + 100


@pytest.mark.parametrize(
    ("changed", "key"),
    [({"rows": 270}, "sensor.rows"), ({"bayer_order": "BGGR"}, "bayer_order"), ({"white_level_dn": 1023.0}, "white_")],
)
def test_a_frame_of_another_sensor_is_refused_by_name(
    hardware: Hardware, bench: Bench, changed: dict[str, object], key: str
) -> None:
    sensor = msgspec.structs.replace(hardware.profile.sensor, **changed)
    other = dataclasses.replace(hardware, profile=msgspec.structs.replace(hardware.profile, sensor=sensor))
    with other, pytest.raises(FrameError, match=f"where the board profile says .*{key}"):
        capture(other, CapturePlan.of_board(other))
    assert not any(bench.currents_ma.values())


def test_a_plan_names_the_currents_that_the_driver_grants(bench: Bench) -> None:
    hardware = wired_hardware(bench, "PCA9955B").hardware
    plan = CapturePlan.of_board(hardware)
    assert plan.currents_ma != hardware.profile.currents_ma
    assert plan.currents_ma == hardware.lights.granted_ma(plan.currents_ma)


def test_a_bus_that_dies_while_lights_shine_is_told_and_the_next_capture_ends_dark(bench: Bench) -> None:
    wired = wired_hardware(bench, "PCA9955B")
    with wired.hardware as hardware:
        plan = CapturePlan.of_board(hardware)
        switch_on = hardware.lights.switch_on

        def switch_on_and_lose_the_bus(currents_ma: Mapping[str, float]) -> None:
            switch_on(currents_ma)
            wired.wire.faults.stuck = True

        hardware.lights.switch_on = switch_on_and_lose_the_bus  # type: ignore[method-assign]
        with pytest.raises(LightError, match="switching all channels off"):
            capture(hardware, plan)
        assert any(wired.leds.currents_ma())
        hardware.lights.switch_on = switch_on  # type: ignore[method-assign]
        wired.wire.faults.stuck = False
        assert capture(hardware, plan).granted.exposure_us > 0.0
        assert not any(wired.leds.currents_ma())


def test_silent_lights_are_an_error_of_the_lights(hardware: Hardware, bench: Bench) -> None:
    with hardware:
        bench.faults.lights_silent = True
        with pytest.raises(LightError):
            capture(hardware, CapturePlan.of_board(hardware))
        bench.faults.lights_silent = False
