import msgspec
import pytest

from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.errors import CameraError, HalError, LightError, OperatorError
from hal.factory import open_hardware
from hal.hardware import Hardware
from hal.interfaces import PressObject
from hal.simulator.bench import SimulatedScene


def test_twin_is_opened_by_name_and_leaves_the_lights_dark(hardware: Hardware, bench: SimulatedScene) -> None:
    with hardware as opened:
        assert opened is hardware
        opened.lights.switch_on(bench.profile.currents_ma)
        assert bench.currents_ma == bench.profile.currents_ma
    assert bench.currents_ma == {}


def _lit(hardware: Hardware, request: PressObject) -> PressObject:
    hardware.lights.switch_on({"red": 1.0})
    return request


def test_lights_go_dark_on_an_error(hardware: Hardware, bench: SimulatedScene) -> None:
    with pytest.raises(OperatorError), hardware:
        hardware.operator.ask(_lit(hardware, PressObject("unicorn")))
    assert bench.currents_ma == {}


def test_opening_fails_loudly_and_releases_what_it_had(hardware: Hardware, bench: SimulatedScene) -> None:
    bench.faults.lights_silent = True
    with pytest.raises(LightError), hardware:
        pass
    with pytest.raises(CameraError, match="not started"):
        hardware.camera.next_frame(1.0)


def test_hardware_opens_again_after_it_was_closed(hardware: Hardware) -> None:
    shapes = []
    for _ in range(2):
        with hardware:
            shapes.append(hardware.camera.next_frame(1.0).mosaic.shape)
    assert shapes[0] == shapes[1]


def test_a_board_without_its_tables_is_named_and_never_replaced(profile: BoardProfile) -> None:
    real = msgspec.structs.replace(profile, driver="picamera2")
    with pytest.raises(HalError, match="lacks one of the tables"):
        open_hardware(real)


def test_open_hardware_takes_clock_and_seed(profile: BoardProfile) -> None:
    clock = VirtualClock(start_ns=7)
    frames = []
    for seed in (1, 1, 2):
        with open_hardware(profile, VirtualClock(), seed) as hardware:
            frames.append(hardware.camera.next_frame(1.0).mosaic)
    assert (frames[0] == frames[1]).all()
    assert (frames[0] != frames[2]).any()
    assert open_hardware(profile, clock).clock is clock
