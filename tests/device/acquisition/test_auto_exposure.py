"""Auto-exposure keeps the brightest level of ball presses below the limit, with the twin and the real drivers."""

import dataclasses

import msgspec
import pytest
from emulated_board import emulated_hardware
from fake_v4l2 import usb_sensor

from device.acquisition.auto_exposure import AIMED_LEVEL, MIN_STEPS, auto_exposure
from device.acquisition.capture import capture
from device.acquisition.guided_calibration import press_places
from device.errors import CalibrationError
from device.imaging.frame_light import BRIGHTEST_PERCENTILE, HIGHEST_LEVEL, Brightness, channel_levels
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.hardware import Hardware
from hal.interfaces import PressBall
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import twin_hardware

BALL_RADIUS_MM = 3.0


def unbalanced(bench: SimulatedScene, factors: tuple[float, float, float], exposure: float) -> SimulatedScene:
    """A world like this one on a board whose currents and exposure are off by these factors."""
    profile = bench.profile
    lights = tuple(
        msgspec.structs.replace(light, current_ma=light.current_ma * factor)
        for light, factor in zip(profile.lights, factors, strict=True)
    )
    camera = msgspec.structs.replace(profile.camera, exposure_us=profile.camera.exposure_us * exposure)
    return build(msgspec.structs.replace(profile, lights=lights, camera=camera), bench.clock)


@pytest.fixture
def bench(small_twin: BoardProfile) -> SimulatedScene:
    """The small twin at half its resolution again: levels need no detail."""
    sensor = msgspec.structs.replace(small_twin.sensor, columns=182, rows=136, pixel_pitch_um=96.0)
    return build(msgspec.structs.replace(small_twin, sensor=sensor), VirtualClock())


@pytest.mark.parametrize(
    ("driver", "factors", "exposure"),
    [
        ("twin", (1.0, 1.0, 1.0), 1.0),
        ("twin", (0.3, 3.0, 1.0), 2.0),
        ("PCA9955B", (0.3, 2.0, 1.0), 2.0),
        ("TLC59116", (2.0, 1.0, 0.5), 0.5),
    ],
)
def test_every_ball_press_of_the_field_stays_below_the_limit(
    bench: SimulatedScene, driver: str, factors: tuple[float, float, float], exposure: float
) -> None:
    world = unbalanced(bench, factors, exposure)
    hardware = twin_hardware(world) if driver == "twin" else emulated_hardware(world, driver).hardware  # type: ignore[arg-type]
    with hardware:
        found = auto_exposure(hardware, BALL_RADIUS_MM, lambda _: None)
        levels = []
        for column, row in press_places():
            hardware.operator.ask(PressBall(BALL_RADIUS_MM, column, row))
            hardware.button.wait_for_press(None)
            levels.append(channel_levels(capture(hardware, found.plan), BRIGHTEST_PERCENTILE))
    highest = [max(values) for values in zip(*levels, strict=True)]
    assert max(highest) <= HIGHEST_LEVEL
    assert min(highest) >= 0.7
    assert found.predicted == pytest.approx((AIMED_LEVEL,) * 3, rel=0.03)


def test_an_exposure_is_never_so_short_that_its_steps_are_coarse(bench: SimulatedScene) -> None:
    short = unbalanced(bench, (1.0, 1.0, 1.0), 0.2)
    sensor = msgspec.structs.replace(short.profile.sensor, exposure_step_us=28.5714)
    world = build(msgspec.structs.replace(short.profile, sensor=sensor), bench.clock)
    hardware = twin_hardware(world)
    with hardware:
        found = auto_exposure(hardware, BALL_RADIUS_MM, lambda _: None)
        granted = capture(hardware, found.plan).granted
    assert found.plan.settings.exposure_us == pytest.approx(MIN_STEPS * sensor.exposure_step_us)
    assert granted.exposure_us == pytest.approx(found.plan.settings.exposure_us, rel=1.0 / MIN_STEPS)


def test_an_invisible_light_is_named(bench: SimulatedScene) -> None:
    bench.faults.open_lights.add("blue")
    hardware = twin_hardware(bench)
    with (
        hardware,
        pytest.raises(CalibrationError, match=r"light blue is hardly visible \(the driver reports open\): run `retro"),
    ):
        auto_exposure(hardware, BALL_RADIUS_MM, lambda _: None)


def test_a_light_that_saturates_at_its_lowest_step_is_named(bench: SimulatedScene) -> None:
    lights = tuple(msgspec.structs.replace(light, current_ma=1.0, max_ma=15.0) for light in bench.profile.lights)
    camera = msgspec.structs.replace(bench.profile.camera, exposure_us=80_000.0)
    world = build(msgspec.structs.replace(bench.profile, lights=lights, camera=camera), bench.clock)
    hardware, _ = usb_sensor(world, switched_by_zoom=True, pixel_format="RGB3")
    with hardware, pytest.raises(CalibrationError, match="light red saturates at its lowest current"):
        auto_exposure(hardware, BALL_RADIUS_MM, lambda _: None)


def test_saturation_by_daylight_is_reported(bench: SimulatedScene, hardware: Hardware) -> None:
    floodlit = dataclasses.replace(hardware)
    straight = bench.drive
    flood = dict.fromkeys(("red", "green", "blue"), 1e5)
    bench.drive = lambda _currents: straight(flood)  # type: ignore[method-assign]
    with floodlit, pytest.raises(CalibrationError, match=r"saturates even with .*shield the gel from daylight"):
        auto_exposure(floodlit, BALL_RADIUS_MM, lambda _: None)


def test_levels_of_a_calibration_are_reported_with_a_warning_if_too_high() -> None:
    found = Brightness((0.32, 0.28, 0.27), (0.5, 0.9, 0.8))
    assert found.sentence == "flat skin at R 32%, G 28%, B 27%, brightest R 50%, G 90%, B 80% of full scale"
    assert found.warning == ""
    assert Brightness.of_figures(found.figures()) == found
    assert Brightness.of_figures(found.figures() | {"flat_level_red": None}) is None
    assert Brightness(found.flat, (0.5, 0.95, 0.8)).warning == (
        "the brightest reach R 50%, G 95%, B 80% of full scale, over 90%: run `retroscan calibrate --auto-exposure`"
    )
