"""The instrument's hardware, opened as one: camera, lights, button, operator and clock."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Self

from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.errors import HalError
from hal.interfaces import Button, Camera, Clock, Lights, Operator


@dataclass(frozen=True, slots=True)
class Hardware:
    """Everything that the instrument touches; entering acquires all of it, leaving releases all of it.

    The lights are entered last, so that they go dark first.
    """

    profile: BoardProfile
    camera: Camera
    lights: Lights
    button: Button
    operator: Operator
    clock: Clock
    _held: ExitStack = field(default_factory=ExitStack, init=False, repr=False, compare=False)

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self.button)
            stack.enter_context(self.camera)
            stack.enter_context(self.lights)
            self._held.push(stack.pop_all())
        return self

    def __exit__(self, *exc: object) -> None:
        self._held.close()


def open_hardware(profile: BoardProfile, clock: Clock | None = None, seed: int | None = None) -> Hardware:
    """The hardware that the profile names: that one or an error, never another in its place.

    Parameters
    ----------
    clock : the clock to run on; the twin runs in virtual time when none is given
    seed : of the twin's noise and placement, instead of the profile's

    Raises
    ------
    HalError
        The profile's driver is not built yet.
    """
    if profile.driver != "twin":
        raise HalError(
            f"board {profile.name!r}: the driver {profile.driver!r} is not built yet; "
            "use a board whose driver is 'twin'"
        )
    from hal.twin.bench import build
    from hal.twin.hardware import twin_hardware

    running = clock or VirtualClock(start_ns=time.monotonic_ns(), wall_start_s=time.time())
    return twin_hardware(build(profile, running, seed))
