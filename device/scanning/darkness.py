"""Lights that could not be switched off, since their bus was gone: tried again until they are dark.

LEDs at scan current heat up within minutes, and nobody may push the button for hours.
"""

from __future__ import annotations

from typing import Final

from hal.errors import HalError
from hal.hardware import Hardware

DARK_AGAIN_S: Final = 1.0
"""How often it is tried again."""


def next_push(hardware: Hardware, longest_wait_s: float | None = None) -> int | None:
    """When the next press began, ns, or None after `longest_wait_s`; meanwhile lights that should be dark are made dark.

    Raises
    ------
    ButtonError
        The button cannot be read.
    """
    waited_s = 0.0
    while not darkened(hardware):
        if (began_ns := hardware.button.wait_for_push(DARK_AGAIN_S)) is not None:
            return began_ns
        waited_s += DARK_AGAIN_S
        if longest_wait_s is not None and waited_s >= longest_wait_s:
            return None
    return hardware.button.wait_for_push(longest_wait_s)


def darkened(hardware: Hardware) -> bool:
    """Whether the light driver took the order to switch every light off."""
    try:
        hardware.lights.dark()
    except HalError:
        return False
    return True
