"""Promises of the twin's devices beyond the Protocols: delayed controls, faults on demand, virtual time."""

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.errors import ButtonError, CameraError, FrameTimeout, LightError, OperatorError
from hal.frame import CameraSettings
from hal.hardware import Hardware
from hal.interfaces import LiftOff, PressBall, PressObject
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import twin_hardware

ASKED = CameraSettings(3_000.0, 2.0)


def test_controls_arrive_frames_late_and_close_but_not_equal(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        before = hardware.camera.next_frame(1.0).granted
        hardware.camera.apply(ASKED)
        granted = [hardware.camera.next_frame(1.0).granted for _ in range(8)]
    assert granted[: bench.twin.control_delay_frames] == [before] * bench.twin.control_delay_frames
    assert granted[bench.twin.control_delay_frames :] == [granted[-1]] * (8 - bench.twin.control_delay_frames)
    assert granted[-1] != ASKED
    assert granted[-1].exposure_us == pytest.approx(ASKED.exposure_us, rel=0.01)
    assert granted[-1].analogue_gain == pytest.approx(ASKED.analogue_gain, rel=0.01)


def test_exposures_are_cut_to_whole_steps_and_what_was_granted_loses_another_when_it_is_asked_again(
    hardware: Hardware, bench: SimulatedScene
) -> None:
    step_us = bench.profile.sensor.exposure_step_us
    asked_us = [2_000.0]
    for _ in range(3):
        hardware.camera.apply(CameraSettings(asked_us[-1], 1.0))
        with hardware:
            asked_us.append(hardware.camera.next_frame(1.0).granted.exposure_us)
    assert all(granted_us == int(granted_us) for granted_us in asked_us)
    assert asked_us[0] - step_us < asked_us[1] <= asked_us[0]
    for granted_us, again_us in pairwise(asked_us[1:]):
        assert granted_us - again_us == pytest.approx(step_us, abs=1.0)


def test_metadata_states_what_the_pixels_show(hardware: Hardware) -> None:
    seen = {}
    with hardware:
        hardware.lights.switch_on({"green": 0.8})
        hardware.clock.sleep(0.1)
        hardware.camera.apply(ASKED)
        for _ in range(8):
            frame = hardware.camera.next_frame(1.0)
            dose = frame.granted.exposure_us * frame.granted.analogue_gain
            seen.setdefault(dose, []).append((frame.mosaic - frame.black_level_dn).mean() / dose)
    assert len(seen) == 2
    rates = np.concatenate([np.array(rates) for rates in seen.values()])
    np.testing.assert_allclose(rates, rates[0], rtol=0.01)


def test_controls_set_before_the_start_act_at_once(hardware: Hardware) -> None:
    hardware.camera.apply(ASKED)
    with hardware:
        assert hardware.camera.next_frame(1.0).granted.exposure_us == pytest.approx(ASKED.exposure_us, rel=0.01)


def test_long_exposures_stretch_the_frame_period(hardware: Hardware) -> None:
    hardware.camera.apply(CameraSettings(100_000.0, 1.0))
    with hardware:
        first, second = (hardware.camera.next_frame(1.0).sensor_timestamp_ns for _ in range(2))
    assert second - first == pytest.approx(101e6, rel=0.01)


def test_a_missing_camera_fails_when_opened(hardware: Hardware, bench: SimulatedScene) -> None:
    bench.faults.camera_missing = True
    with pytest.raises(CameraError, match="not there"):
        hardware.__enter__()


def test_a_stalled_camera_times_out_in_virtual_time_and_recovers(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        bench.faults.camera_stalled = True
        asked_ns = bench.clock.monotonic_ns()
        with pytest.raises(FrameTimeout, match=r"2 s.*cable"):
            hardware.camera.next_frame(2.0)
        assert bench.clock.monotonic_ns() - asked_ns == 2_000_000_000
        bench.faults.camera_stalled = False
        assert hardware.camera.next_frame(1.0).sensor_timestamp_ns > asked_ns + 1_900_000_000


def test_a_frame_that_comes_too_late_is_a_timeout(hardware: Hardware) -> None:
    with hardware, pytest.raises(FrameTimeout):
        hardware.camera.next_frame(1e-4)


def test_controls_that_never_arrive(hardware: Hardware, bench: SimulatedScene) -> None:
    bench.faults.controls_ignored = True
    with hardware:
        hardware.camera.apply(ASKED)
        granted = {hardware.camera.next_frame(1.0).granted for _ in range(12)}
    assert len(granted) == 1
    assert ASKED.analogue_gain not in {g.analogue_gain for g in granted}


def test_a_silent_light_driver_is_an_error_in_every_call(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware:
        bench.faults.lights_silent = True
        for call in (hardware.lights.off, hardware.lights.faults, lambda: hardware.lights.switch_on({"red": 1.0})):
            with pytest.raises(LightError, match="acknowledge"):
                call()
        bench.faults.lights_silent = False


def test_broken_lights_give_a_black_frame_and_say_so(hardware: Hardware, bench: SimulatedScene) -> None:
    bench.faults.lights_broken = True
    with hardware:
        hardware.lights.switch_on(bench.profile.currents_ma)
        hardware.clock.sleep(0.1)
        frame = hardware.camera.next_frame(1.0)
        assert {fault.light for fault in hardware.lights.faults()} == set(hardware.lights.names)
    assert frame.mosaic.mean() == pytest.approx(frame.black_level_dn, abs=0.1)


def test_waiting_for_ever_for_nobody_is_an_error(hardware: Hardware) -> None:
    with hardware, pytest.raises(ButtonError, match="operator"):
        hardware.button.wait_for_press(None)


def test_an_unreadable_button(hardware: Hardware, bench: SimulatedScene) -> None:
    bench.faults.button_unreadable = True
    with hardware, pytest.raises(ButtonError, match="line name"):
        hardware.button.wait_for_press(1.0)


def test_presses_come_in_the_order_they_were_asked(hardware: Hardware) -> None:
    with hardware:
        hardware.operator.ask(LiftOff())
        hardware.clock.sleep(0.1)
        hardware.operator.ask(PressBall(3.0, 0.5, 0.5))
        first, second = hardware.button.wait_for_press(None), hardware.button.wait_for_press(None)
    assert first is not None
    assert second is not None
    assert second.began_ns - first.began_ns == 100_000_000


def test_a_thin_gel_refuses_a_deep_object(profile: BoardProfile) -> None:
    gel = msgspec.structs.replace(profile.gel, slab_thickness_mm=0.6)
    hardware = twin_hardware(build(msgspec.structs.replace(profile, gel=gel), VirtualClock()))
    with pytest.raises(OperatorError, match=r"needs 0\.5 mm, .*0\.36 mm"):
        hardware.operator.ask(PressObject("coin"))


def test_a_ball_without_size_is_refused(hardware: Hardware) -> None:
    with pytest.raises(OperatorError, match="radius"):
        hardware.operator.ask(PressBall(0.0, 0.5, 0.5))
