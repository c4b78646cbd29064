"""What the LED drivers' registers share: two bits an output, transfers that walk, writes that are read back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hal.errors import LightError
from hal.i2c_bus import I2cChip

CHANNELS: Final = 16
INCREMENT: Final = 0x80
"""The control byte's bit that makes a transfer walk through all registers."""


def packed_outputs(states: Mapping[int, int]) -> list[int]:
    """LEDOUT registers, two bits a channel, four channels a register."""
    packed = [0] * (CHANNELS // 4)
    for channel, state in states.items():
        packed[channel // 4] |= state << 2 * (channel % 4)
    return packed


def prove(chip: I2cChip, register: int, written: list[int], what: str) -> None:
    """Read back what was written.

    Raises
    ------
    LightError
        The chip does not answer, or holds something else.
    """
    found = list(chip.read(register | INCREMENT, len(written), what))
    if found != written:
        raise LightError(
            f"the {chip.place} did not keep its {what} (wrote {written}, reads {found}): "
            "check its supply for dips, and that it is this chip at this address"
        )
