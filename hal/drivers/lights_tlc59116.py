"""TLC59116: 16 channels share one current, and each is dimmed by its own duty cycle.

The duty cycles repeat at 97 kHz, far faster than any exposure.

The 190 Hz group dimming is never used: it would cause bands with a rolling shutter. Register numbers follow TI's data
sheet SLDS157; auto-increment is in the top bits of the control byte.

Error flags follow the later sheet SLDS223A: a bit that reads 0 is an error. SLDS157E states the opposite; TI's forum
reports chips that behave as in the later sheet. Open circuits are detected only in a channel that is on without PWM, so
driven channels are fully on while flags are read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hal.drivers.chip_lights import CHANNELS, INCREMENT, drive_outputs, packed_outputs, verify_registers
from hal.drivers.i2c_bus import I2cChip

STEPS: Final = 256
AMPERE_OHM: Final = 15.0 * 1.26 * 127.0 / 128.0
"""Full current times the reference resistor at the power-on gain."""

MODE1: Final = 0x00
MODE2: Final = 0x01
PWM0: Final = 0x02
LEDOUT0: Final = 0x14
IREF: Final = 0x1C
EFLAG1: Final = 0x1D

AWAKE: Final = 0x00
CLEAR_ERRORS: Final = 0x80
FULL_GAIN: Final = 0xFF
FULLY_ON: Final = 0b01
OWN_DUTY: Final = 0b10


class Tlc59116:
    """See `hal.drivers.chip_lights.LedChip`. Currents are means over the duty cycle.

    reference_ohm : resistor at REXT
    """

    def __init__(self, chip: I2cChip, reference_ohm: float) -> None:
        self._chip = chip
        self._full_ma = 1e3 * AMPERE_OHM / reference_ohm

    @property
    def max_ma(self) -> float:
        """Maximum mean current of a channel, mA."""
        return self._full_ma * (STEPS - 1) / STEPS

    def granted_ma(self, current_ma: float) -> float:
        """Return the mean current (mA) of the nearest duty cycle."""
        return self._duty(current_ma) * self._full_ma / STEPS

    def start(self) -> None:
        """Wake without all-call addresses, every channel off, the shared current at its power-on gain.

        Raises
        ------
        LightError
            The chip does not answer, or does not keep what is written: it is another chip.
        """
        self.off()
        self._chip.write(MODE1, [AWAKE], "waking it")
        self._chip.write(IREF, [FULL_GAIN], "setting the shared current")
        self._clear_errors()
        verify_registers(self._chip, LEDOUT0, [0] * (CHANNELS // 4), "outputs")

    def drive(self, currents_ma: Mapping[int, float]) -> None:
        """Write duty cycles, then outputs, and read both back.

        Raises
        ------
        LightError
            The chip does not answer, or lost what was written.
        """
        duties = [self._duty(currents_ma.get(channel, 0.0)) for channel in range(CHANNELS)]
        drive_outputs(self._chip, (PWM0, duties, "duties"), LEDOUT0, OWN_DUTY)

    def off(self) -> None:
        """Switch every output off."""
        self._chip.write(LEDOUT0 | INCREMENT, [0] * (CHANNELS // 4), "switching all channels off")

    def flags(self) -> dict[int, str]:
        """ "open" by driven channel (over-temperature sets the same bits); driven channels are fully on meanwhile."""
        outputs = list(self._chip.read(LEDOUT0 | INCREMENT, CHANNELS // 4, "outputs"))
        driven = [channel for channel in range(CHANNELS) if outputs[channel // 4] >> 2 * (channel % 4) & 0b11]
        if not driven:
            return {}
        self._chip.write(LEDOUT0 | INCREMENT, packed_outputs(dict.fromkeys(driven, FULLY_ON)), "looking for faults")
        try:
            self._clear_errors()
            low, high = self._chip.read(EFLAG1 | INCREMENT, 2, "fault flags")
        finally:
            self._chip.write(LEDOUT0 | INCREMENT, outputs, "driving on")
        sound = low | high << 8
        return {channel: "open" for channel in driven if not sound >> channel & 1}

    def close(self) -> None:
        """Release the bus."""
        self._chip.close()

    def _clear_errors(self) -> None:
        self._chip.write(MODE2, [CLEAR_ERRORS], "clearing fault flags")
        self._chip.write(MODE2, [0x00], "watching for faults")

    def _duty(self, current_ma: float) -> int:
        if current_ma <= 0.0:
            return 0
        return min(max(round(current_ma * STEPS / self._full_ma), 1), STEPS - 1)
