"""The instrument's hardware, opened as one: camera, lights, button, operator and clock."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Self

from hal.board_profile import BoardProfile
from hal.clock import SystemClock, VirtualClock
from hal.errors import IndicatorError, LightError
from hal.interfaces import Button, Camera, Clock, Indicator, Lights, Operator, Power


@dataclass(frozen=True, slots=True)
class Hardware:
    """Everything that the instrument touches; entering acquires all of it, leaving releases all of it.

    The lights go dark before anything else is touched, and first when it is left; the indicator may sit on their chip.
    An indicator that cannot be driven does not keep the rest from being used; the self-test names it.
    """

    profile: BoardProfile
    camera: Camera
    lights: Lights
    button: Button
    indicator: Indicator
    power: Power
    operator: Operator
    clock: Clock
    _held: ExitStack = field(default_factory=ExitStack, init=False, repr=False, compare=False)

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self.button)
            stack.enter_context(self.power)
            stack.enter_context(self.lights)
            stack.enter_context(_if_it_works(self.indicator))
            stack.enter_context(self.camera)
            stack.callback(self.lights.dark)
            self._held.push(stack.pop_all())
        return self

    def __exit__(self, *exc: object) -> None:
        self._held.close()


@contextmanager
def _if_it_works(indicator: Indicator) -> Iterator[None]:
    """The indicator entered and left, or left alone."""
    with ExitStack() as stack:
        with suppress(IndicatorError, LightError):
            stack.enter_context(indicator)
        try:
            yield
        finally:
            with suppress(IndicatorError, LightError):
                stack.close()


def open_hardware(profile: BoardProfile, clock: Clock | None = None, seed: int | None = None) -> Hardware:
    """The hardware that the profile names: that one or an error, never another in its place.

    Parameters
    ----------
    clock : the clock to run on; the twin runs in virtual time when none is given
    seed : of the twin's noise and placement, instead of the profile's

    Raises
    ------
    BoardProfileError
        The profile lacks a table that its driver needs.
    """
    if profile.driver == "picamera2":
        from hal.board_hardware import board_hardware

        return board_hardware(profile, clock or SystemClock())
    if profile.driver == "twin-camera":
        from hal.twin.wired.followed_board import followed_board

        return followed_board(profile, clock or SystemClock(), seed)
    from hal.twin.bench import build
    from hal.twin.hardware import twin_hardware

    running = clock or VirtualClock(start_ns=time.monotonic_ns(), wall_start_s=time.time())
    return twin_hardware(build(profile, running, seed))
