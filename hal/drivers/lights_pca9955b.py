"""PCA9955B: 16 channels, each with its own 8-bit current; outputs are fully on, so no PWM modulates image rows.

Register numbers and bits follow NXP's data sheet. Some public libraries place IREF0 at 22h and the ERROR bit at 20h;
both are wrong for this chip.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hal.drivers.chip_lights import CHANNELS, INCREMENT, drive_outputs, verify_registers
from hal.drivers.i2c_bus import I2cChip

STEPS: Final = 255
VOLT_OHM_PER_STEP: Final = 0.9 / 4.0
"""A step of current is this voltage over the reference resistor: 225 µA at 1 kΩ."""

MODE1: Final = 0x00
MODE2: Final = 0x01
LEDOUT0: Final = 0x02
IREF0: Final = 0x18
PWM_ALL: Final = 0x44
IREF_ALL: Final = 0x45
EFLAG0: Final = 0x46

AWAKE: Final = 0x00
CLEAR_ERRORS: Final = 0x10
ERROR: Final = 0x40
TOO_HOT: Final = 0x80
FULLY_ON: Final = 0b01
FLAGS: Final = {0b01: "short", 0b10: "open"}


class Pca9955b:
    """See `hal.drivers.chip_lights.LedChip`; `reference_ohm` is the resistor at REXT."""

    def __init__(self, chip: I2cChip, reference_ohm: float) -> None:
        self._chip = chip
        self._step_ma = 1e3 * VOLT_OHM_PER_STEP / reference_ohm

    @property
    def max_ma(self) -> float:
        """Maximum current of a channel, mA."""
        return STEPS * self._step_ma

    def granted_ma(self, current_ma: float) -> float:
        """Return the nearest step of the channel current, mA."""
        return self._steps(current_ma) * self._step_ma

    def start(self) -> None:
        """Wake without all-call addresses, every channel off, old flags cleared.

        Raises
        ------
        LightError
            The chip does not answer, or does not keep what is written: it is another chip.
        """
        self.off()
        self._chip.write(MODE1, [AWAKE], "waking it")
        self._chip.write(IREF_ALL, [0], "setting all currents to 0")
        self._chip.write(PWM_ALL, [0xFF], "setting the duty")
        self._clear_errors()
        verify_registers(self._chip, LEDOUT0, [0] * (CHANNELS // 4), "outputs")

    def drive(self, currents_ma: Mapping[int, float]) -> None:
        """Write currents, then outputs, and read both back; earlier flags are cleared.

        Raises
        ------
        LightError
            The chip does not answer, or lost what was written.
        """
        steps = [self._steps(currents_ma.get(channel, 0.0)) for channel in range(CHANNELS)]
        self._clear_errors()
        drive_outputs(self._chip, (IREF0, steps, "currents"), LEDOUT0, FULLY_ON)

    def off(self) -> None:
        """Switch every output off."""
        self._chip.write(LEDOUT0 | INCREMENT, [0] * (CHANNELS // 4), "switching all channels off")

    def flags(self) -> dict[int, str]:
        """Open and short by channel, "hot" for all, latched since the outputs were last driven."""
        mode = self._chip.read(MODE2, 1, "fault flags")[0]
        if mode & TOO_HOT:
            return dict.fromkeys(range(CHANNELS), "hot")
        if not mode & ERROR:
            return {}
        # Auto-increment ends at 43h: beyond it, a transfer keeps reading the same register.
        words = [self._chip.read(EFLAG0 + n, 1, "fault flags")[0] for n in range(CHANNELS // 4)]
        bits = {channel: words[channel // 4] >> 2 * (channel % 4) & 0b11 for channel in range(CHANNELS)}
        return {channel: FLAGS[bit] for channel, bit in bits.items() if bit in FLAGS}

    def close(self) -> None:
        """Release the bus."""
        self._chip.close()

    def _clear_errors(self) -> None:
        mode = self._chip.read(MODE2, 1, "fault flags")[0]
        self._chip.write(MODE2, [mode & 0x2F | CLEAR_ERRORS], "clearing fault flags")

    def _steps(self, current_ma: float) -> int:
        if current_ma <= 0.0:
            return 0
        return min(max(round(current_ma / self._step_ma), 1), STEPS)
