"""This machine's bus and lines under the twin's camera: the simulated world follows what is written to the real bus.

For boards without a camera, such as a virtual one: button and lights go through the kernel, and since the driver chip's
model sees every transfer that the bus took, a frame shows the lights that the driver really switched. An object lies on
the gel from the start, because a button that somebody pushes asks no operator for one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from hal.board_hardware import Machine, board_hardware
from hal.board_parts import LightDriverFacts
from hal.board_profile import BoardProfile
from hal.errors import BoardProfileError
from hal.hardware import Hardware
from hal.i2c_bus import OpenBus, SmBus
from hal.interfaces import Clock, PressObject
from hal.twin.bench import build
from hal.twin.camera import TwinCamera
from hal.twin.operator import TwinOperator
from hal.twin.wired.chip_models import LedDriverModel
from hal.twin.wired.hardware import led_model, lighting

ON_THE_GEL: Final = PressObject("coin")


class FollowedBus:
    """A bus whose chip at one address has a model that is told of every write that went through; see `SmBus`."""

    def __init__(self, bus: SmBus, address: int, model: LedDriverModel) -> None:
        self._bus = bus
        self._address = address
        self._model = model

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        """Registers from `register` on, as the bus has them."""
        return self._bus.read_i2c_block_data(i2c_addr, register, length)

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int]) -> None:
        """Write registers from `register` on; one that fails is not followed."""
        self._bus.write_i2c_block_data(i2c_addr, register, data)
        if i2c_addr == self._address:
            self._model.write(register, data)

    def close(self) -> None:
        """Give the bus back."""
        self._bus.close()


def followed_board(
    profile: BoardProfile, clock: Clock, seed: int | None = None, machine: Machine | None = None
) -> Hardware:
    """The hardware of a profile whose driver is "twin-camera"; nothing is touched before it is entered.

    Raises
    ------
    BoardProfileError
        The profile lacks a table that it needs.
    """
    facts = profile.light_driver
    if facts is None:
        raise BoardProfileError(f"board {profile.name!r} has no [light_driver] table: complete it")
    world = build(profile, clock, seed)
    operator = TwinOperator(world)
    operator.ask(ON_THE_GEL)
    model = led_model(facts.chip)
    model.changed = lighting(world, model)
    machine = machine or Machine()
    followed = replace(machine, open_bus=_following(machine.open_bus, facts, model))
    return board_hardware(profile, clock, followed, operator, TwinCamera(world))


def _following(open_bus: OpenBus, facts: LightDriverFacts, model: LedDriverModel) -> Callable[[int], SmBus]:
    """Opens buses; the light driver's own is followed."""

    def opened(number: int) -> SmBus:
        bus = open_bus(number)
        return FollowedBus(bus, facts.address, model) if number == facts.bus else bus

    return opened
