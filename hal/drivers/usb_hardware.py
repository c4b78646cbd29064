"""A sensor on USB as hardware: its camera, its lights, and the terminal's Enter key as the button."""

from __future__ import annotations

from hal.board_profile import BoardProfile
from hal.drivers.blink_indicator import NoIndicator
from hal.drivers.button_keyboard import KeyboardButton, KeyLine, Terminal
from hal.drivers.camera_uvc import UvcCamera
from hal.drivers.power_board import BoardPower
from hal.drivers.uvc_choice import ChosenCamera
from hal.drivers.uvc_lights import AlwaysOnLights, ZoomControlLights
from hal.drivers.v4l2_stack import VideoStack
from hal.errors import BoardProfileError, DriverMissing
from hal.hardware import Hardware, ManualOperator
from hal.interfaces import Button, Clock, Lights, Operator


def usb_hardware(
    profile: BoardProfile,
    clock: Clock,
    stack: VideoStack | None = None,
    keys: KeyLine | None = None,
    operator: Operator | None = None,
    button: Button | None = None,
) -> Hardware:
    """The hardware of a sensor on USB; nothing is accessed before it is entered.

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
