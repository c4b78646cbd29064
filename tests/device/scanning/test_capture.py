import pytest

from device.errors import FrameNotProven
from device.scanning.capture import MOST_FRAMES, CapturePlan, capture
from hal.errors import FrameTimeout, LightError
from hal.frame import CameraSettings
from hal.hardware import Hardware
from hal.twin.bench import Bench


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


def test_silent_lights_are_an_error_of_the_lights(hardware: Hardware, bench: Bench) -> None:
    with hardware:
        bench.faults.lights_silent = True
        with pytest.raises(LightError):
            capture(hardware, CapturePlan.of_board(hardware))
        bench.faults.lights_silent = False
