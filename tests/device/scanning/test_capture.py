import dataclasses
from collections.abc import Mapping

import msgspec
import pytest

from device.errors import FrameError, FrameNotProven
from device.scanning.capture import MOST_FRAMES, CapturePlan, capture
from hal.errors import FrameTimeout, LightError
from hal.frame import CameraSettings
from hal.hardware import Hardware
from hal.twin.bench import Bench
from hal.twin.wired.hardware import wired_hardware


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
