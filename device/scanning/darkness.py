"""Lights that could not be switched off, since their bus was gone: tried again until they are dark.

LEDs at scan current heat up within minutes, and nobody may push the button for hours.
"""

from __future__ import annotations

from typing import Final

from hal.errors import HalError
from hal.hardware import Hardware

DARK_AGAIN_S: Final = 1.0
"""How often it is tried again."""


def next_push(hardware: Hardware) -> int | None:
    """When the next press began, ns; until then lights that should be dark are made dark.

    Raises
    ------
    ButtonError
        The button cannot be read.
    """
    while not darkened(hardware):
        if (began_ns := hardware.button.wait_for_push(DARK_AGAIN_S)) is not None:
            return began_ns
    return hardware.button.wait_for_push(None)


def darkened(hardware: Hardware) -> bool:
    """Whether the light driver took the order to switch every light off."""
    try:
        hardware.lights.dark()
    except HalError:
        return False
    return True
