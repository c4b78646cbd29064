"""This machine's bus and lines with the twin's camera: the simulated world mirrors what is written to the real bus.

For boards without a camera, such as a virtual one: button and lights go through the kernel, and the model of the driver
chip receives every transfer on the bus, so a frame shows the lights that the driver really switched. An object lies on
the gel from the start, because a person who pushes the button sends no request to the operator.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from hal.board_profile import BoardProfile, LightDriverConfig
from hal.drivers.board_hardware import Machine, board_hardware
from hal.drivers.i2c_bus import OpenBus, SmBus
from hal.errors import BoardProfileError
from hal.hardware import Hardware
from hal.interfaces import Clock, PressObject
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.camera import TwinCamera
from hal.simulator.led_chips import LedDriverModel, Pca9955bModel, Tlc59116Model
from hal.simulator.operator import TwinOperator

ON_THE_GEL: Final = PressObject("coin")


class MirroredBus:
    """A bus that forwards every successful write at one address to a chip model; see `SmBus`."""

    def __init__(self, bus: SmBus, address: int, model: LedDriverModel) -> None:
        self._bus = bus
        self._address = address
        self._model = model

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        """Read registers from `register` on, from the real bus."""
        return self._bus.read_i2c_block_data(i2c_addr, register, length)

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int]) -> None:
        """Write registers from `register` on; failed writes are not mirrored."""
        self._bus.write_i2c_block_data(i2c_addr, register, data)
        if i2c_addr == self._address:
            self._model.write(register, data)

    def close(self) -> None:
        """Release the bus."""
        self._bus.close()


def mirrored_board_hardware(
    profile: BoardProfile, clock: Clock, seed: int | None = None, machine: Machine | None = None
) -> Hardware:
    """Return the hardware of a profile whose driver is "twin-camera"; nothing is accessed before it is entered.

    Raises
    ------
    BoardProfileError
        The profile lacks a required table.
    """
    config = profile.light_driver
    if config is None:
        raise BoardProfileError(f"board {profile.name!r} has no [light_driver] table: add it")
    world = build(profile, clock, seed)
    operator = TwinOperator(world)
    operator.ask(ON_THE_GEL)
    model = led_model(config.chip, config.reference_ohm)
    model.changed = lighting(world, model)
    machine = machine or Machine()
    mirrored = replace(machine, open_bus=_mirroring(machine.open_bus, config, model))
    return board_hardware(profile, clock, mirrored, operator, TwinCamera(world))


def _mirroring(open_bus: OpenBus, config: LightDriverConfig, model: LedDriverModel) -> Callable[[int], SmBus]:
    """Opens buses; that of the light driver is mirrored."""

    def opened(number: int) -> SmBus:
        bus = open_bus(number)
        return MirroredBus(bus, config.address, model) if number == config.bus else bus

    return opened


def led_model(chip: str, reference_ohm: float) -> LedDriverModel:
    """Register model of that chip with that resistor at REXT, in its power-on state."""
    return (Pca9955bModel if chip == "PCA9955B" else Tlc59116Model)(reference_ohm)


def lighting(world: SimulatedScene, leds: LedDriverModel) -> Callable[[], None]:
    """Return a callback that drives each light of the world with the mean current of its LEDs, from the chip's
    registers."""

    def follow() -> None:
        currents_ma = leds.currents_ma()
        shining = {
            light.name: sum(currents_ma[channel] for channel in light.channels) / len(light.channels)
            for light in world.profile.lights
        }
        world.drive({name: current for name, current in shining.items() if current > 0.0})

    return follow
