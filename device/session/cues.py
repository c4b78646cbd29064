"""Cues on the indicator: an indicator that fails never costs a scan."""

from __future__ import annotations

from contextlib import suppress
from typing import Final

from device.session.events import RefusalReason
from hal.errors import HalError
from hal.hardware import Hardware
from hal.interfaces import Cue

REFUSALS: Final[dict[RefusalReason, Cue]] = {
    "busy": "refused",
    "calibration": "refused: calibration",
    "full": "refused: full",
    "hardware": "refused: hardware",
}


def show(hardware: Hardware, cue: Cue) -> None:
    """Play a cue."""
    with suppress(HalError):
        hardware.indicator.show(cue)
