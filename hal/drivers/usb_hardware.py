"""A sensor on USB as hardware: its camera, its lights, and the terminal's Enter key as the button."""

from __future__ import annotations

import os
import select
import sys
from typing import Final, Protocol, Self

from hal.board_profile import BoardProfile
from hal.drivers.camera_uvc import ChosenCamera, UvcCamera
from hal.drivers.gpio_lines import NoIndicator
from hal.drivers.power_board import BoardPower
from hal.drivers.uvc_lights import AlwaysOnLights, ZoomControlLights
from hal.drivers.v4l2_stack import VideoStack
from hal.errors import BoardProfileError, ButtonError, DriverMissing
from hal.hardware import Hardware, ManualOperator
from hal.interfaces import Button, ButtonPress, Clock, Lights, Operator


def usb_hardware(
    profile: BoardProfile,
    clock: Clock,
    stack: VideoStack | None = None,
    keys: KeyLine | None = None,
    operator: Operator | None = None,
    button: Button | None = None,
) -> Hardware:
    """Return the hardware of a sensor on USB; nothing is accessed before it is entered.

    stack, keys, operator, button : emulated ones, instead of this machine's

    Raises
    ------
    BoardProfileError
        The profile has no [uvc] table.
    DriverMissing
        This system has no video interface like Linux's.
    """
    if profile.uvc is None:
        raise BoardProfileError(f"board {profile.name!r} has no [uvc] table: add it")
    chosen = ChosenCamera(stack or _kernel_video(), profile.uvc.card)
    lights: Lights = AlwaysOnLights(profile.lights)
    if not profile.lights_always_on:
        lights = ZoomControlLights(profile.lights, chosen)
    return Hardware(
        profile=profile,
        camera=UvcCamera(profile.sensor, profile.uvc, profile.camera.settings, chosen, clock),
        lights=lights,
        button=button or KeyboardButton(keys or Terminal(clock), clock),
        indicator=NoIndicator(),
        power=BoardPower(None, None),
        operator=operator or ManualOperator(),
        clock=clock,
    )


def _kernel_video() -> VideoStack:
    try:
        from hal.drivers.v4l2_kernel import KernelVideo
    except ImportError as error:
        raise DriverMissing("sensors on USB are read through Linux's video interface: use a Linux machine") from error
    return KernelVideo()


# The Enter key of the terminal as the push button, for sensors without a button.
#
# While another part of the program reads the terminal key by key, such as the screens, the keys are left to it.

KEY_HELD_S: Final = 0.1
"""A key counts as held for this long: a terminal reports no release."""

FOREVER_S: Final = 3600.0


class KeyLine(Protocol):
    """Source of whole lines."""

    def wait(self, timeout_s: float) -> int:
        """Return the number of Enter keys pressed, as soon as there is one, or 0 after `timeout_s`.

        Raises
        ------
        OSError
            No more lines can come.
        """
        ...


class Terminal:
    """The terminal that the program was started in; see `KeyLine`."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def wait(self, timeout_s: float) -> int:
        """Return the number of Enter keys pressed; keys are left alone while the terminal is not read by lines."""
        handle = sys.stdin.fileno()
        if not _reads_lines(handle):
            self._clock.sleep(timeout_s)
            return 0
        if not select.select([handle], [], [], timeout_s)[0]:
            return 0
        typed = os.read(handle, 4096)
        if not typed:
            raise OSError("the terminal was closed")
        return typed.count(b"\n")


class KeyboardButton:
    """See `hal.interfaces.Button`."""

    def __init__(self, line: KeyLine, clock: Clock) -> None:
        self._line = line
        self._clock = clock
        self._pushes: list[int] = []
        self._released: list[int] = []

    def wait_for_push(self, timeout_s: float | None) -> int | None:
        """Return the time of the next Enter key (ns), or None after `timeout_s`.

        Raises
        ------
        ButtonError
            The terminal cannot be read.
        """
        self._fill(self._pushes, timeout_s)
        if not self._pushes:
            return None
        began_ns = self._pushes.pop(0)
        self._released.append(began_ns)
        return began_ns

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """Return the next Enter key, or the one that `wait_for_push` reported; None after `timeout_s`."""
        if not self._released:
            self.wait_for_push(timeout_s)
        return ButtonPress(self._released.pop(0), KEY_HELD_S) if self._released else None

    def is_down(self) -> bool:
        """Always False: a terminal reports no release."""
        return False

    def clear_presses(self) -> int:
        """Drop all keys so far; returns how many `wait_for_push` had not reported."""
        self._read(0.0)
        dropped = len(self._pushes)
        self._pushes.clear()
        self._released.clear()
        return dropped

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None

    def _fill(self, waiting: list[int], timeout_s: float | None) -> None:
        end_ns = None if timeout_s is None else self._clock.monotonic_ns() + round(timeout_s * 1e9)
        while not waiting:
            left_s = FOREVER_S if end_ns is None else (end_ns - self._clock.monotonic_ns()) * 1e-9
            self._read(max(left_s, 0.0))
            if left_s <= 0.0:
                return

    def _read(self, timeout_s: float) -> None:
        try:
            count = self._line.wait(timeout_s)
        except (OSError, ValueError) as error:
            raise ButtonError(f"the Enter key cannot be read ({error}): start the program in a terminal") from error
        self._pushes.extend([self._clock.monotonic_ns()] * count)


def _reads_lines(handle: int) -> bool:
    """Return whether a terminal hands out whole lines; a pipe does."""
    if not os.isatty(handle):
        return True
    import termios

    return bool(termios.tcgetattr(handle)[3] & termios.ICANON)
