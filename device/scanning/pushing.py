"""Asking whoever holds the instrument for something, and waiting for the push that answers."""

from __future__ import annotations

from typing import Final

from hal.errors import ButtonError
from hal.hardware import Hardware
from hal.interfaces import OperatorRequest

BUTTON_TIMEOUT_S: Final = 300.0


def await_push(hardware: Hardware, request: OperatorRequest) -> None:
    """Hand over a request and return as soon as the button goes down; how that push ends is nobody's concern.

    Raises
    ------
    ButtonError
        Nobody pushed, or the button cannot be read.
    """
    hardware.operator.ask(request)
    if hardware.button.wait_for_push(BUTTON_TIMEOUT_S) is None:
        raise ButtonError(f"the button was not pushed within {BUTTON_TIMEOUT_S:.0f} s: start again")
    hardware.button.forget_presses()
