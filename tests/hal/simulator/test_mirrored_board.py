"""A board with this machine's bus and lines and the twin's camera: frames show what the bus transferred."""

from pathlib import Path

import msgspec
import pytest
from emulated_board import LIGHTS_AT, emulated_profile
from fake_gpio import FakeGpioLine
from fake_i2c import FakeI2cBus

from device.acquisition.selftest import selftest
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.drivers.board_hardware import Machine
from hal.drivers.i2c_bus import SmBus
from hal.errors import BoardProfileError, LightError
from hal.factory import open_hardware
from hal.hardware import Hardware
from hal.simulator.bench import build
from hal.simulator.hardware import MirroredBus, mirrored_board_hardware
from hal.simulator.led_chips import Pca9955bModel


@pytest.fixture
def twin_camera(profile: BoardProfile) -> BoardProfile:
    emulated = emulated_profile(profile, "PCA9955B")
    return msgspec.structs.replace(emulated, driver="twin-camera", libcamera=None, power=None)


@pytest.fixture
def wire() -> FakeI2cBus:
    return FakeI2cBus({LIGHTS_AT: Pca9955bModel()}, VirtualClock())


@pytest.fixture
def board(twin_camera: BoardProfile, wire: FakeI2cBus) -> Hardware:
    clock = wire.clock
    line = FakeGpioLine(build(twin_camera, clock))
    machine = Machine(open_bus=wire.open, open_input=lambda *_place: lambda: line)
    return mirrored_board_hardware(twin_camera, clock, machine=machine)


def test_every_part_passes_its_self_test(board: Hardware) -> None:
    found = {finding.part: finding.state for finding in selftest(board)}
    assert set(found.values()) == {"ok"}
    assert {"light red", "light green", "light blue", "camera", "button", "darkness"} <= set(found)


def test_a_light_that_the_bus_refuses_stays_dark_in_the_frame(board: Hardware, wire: FakeI2cBus) -> None:
    with board:
        wire.faults.unplugged.add(LIGHTS_AT)
        with pytest.raises(LightError, match="no chip answers at 0x15 on bus 1"):
            board.lights.switch_on(board.profile.currents_ma)
        frame = board.camera.next_frame(1.0)
        wire.faults.unplugged.clear()
        board.lights.switch_on(board.profile.currents_ma)
        board.clock.sleep(0.1)
        lit = board.camera.next_frame(1.0)
    assert frame.mosaic.mean() < frame.black_level_dn + 5.0
    assert lit.mosaic.mean() > frame.black_level_dn + 200.0


def test_another_chip_on_the_bus_is_not_followed(wire: FakeI2cBus) -> None:
    model = Pca9955bModel()
    wire.chips[LIGHTS_AT + 1] = Pca9955bModel()
    bus: SmBus = MirroredBus(wire.open(1), LIGHTS_AT, model)
    bus.write_i2c_block_data(LIGHTS_AT + 1, 0x00, [0x00])
    assert model.registers[0x00] == 0x89
    bus.write_i2c_block_data(LIGHTS_AT, 0x00, [0x00])
    assert model.registers[0x00] == bus.read_i2c_block_data(LIGHTS_AT, 0x00, 1)[0] == 0x00


def test_the_profile_of_the_virtual_board_is_complete() -> None:
    profile = load_board_profile(Path(__file__).parents[2] / "system/virtual-board.toml")
    hardware = open_hardware(profile, VirtualClock())
    assert hardware.camera.camera_id == "twin/IMX296"


@pytest.mark.parametrize("table", ["twin", "light_driver"])
def test_a_missing_table_is_named(twin_camera: BoardProfile, table: str) -> None:
    with pytest.raises(BoardProfileError, match=table):
        open_hardware(msgspec.structs.replace(twin_camera, **{table: None}), VirtualClock())
