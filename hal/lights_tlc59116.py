"""TLC59116: 16 channels that share one current; each is dimmed by its own 97 kHz duty, far above any row's exposure.

The 190 Hz group dimming is never used: it would draw bands over a rolling shutter. Register numbers follow TI's data
sheet SLDS157; auto-increment is the control byte's top bits.

Error flags follow the later sheet SLDS223A: a bit that reads 0 is an error. SLDS157E has it the other way round; TI's
forum reports chips that behave as the later sheet says. Open circuits are seen only in a channel that is on without
PWM, so the driven channels are fully on for the moment in which the flags are read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hal.i2c_bus import I2cChip
from hal.led_registers import CHANNELS, INCREMENT, packed_outputs, prove

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
    """See `hal.chip_lights.LedChip`; `reference_ohm` is the resistor at REXT. A current is a mean over the duty."""

    def __init__(self, chip: I2cChip, reference_ohm: float) -> None:
        self._chip = chip
        self._full_ma = 1e3 * AMPERE_OHM / reference_ohm

    @property
    def highest_ma(self) -> float:
        """The most that a channel can carry in the mean, mA."""
        return self._full_ma * (STEPS - 1) / STEPS

    def granted_ma(self, current_ma: float) -> float:
        """The mean current (mA) of the nearest duty."""
        return self._duty(current_ma) * self._full_ma / STEPS

    def start(self) -> None:
        """Awake without all-call addresses, every channel off, the shared current at its power-on gain.

        Raises
        ------
        LightError
            The chip does not answer, or what was written does not stay: it is another chip.
        """
        self.dark()
        self._chip.write(MODE1, [AWAKE], "waking it")
        self._chip.write(IREF, [FULL_GAIN], "setting the shared current")
        self._clear_errors()
        prove(self._chip, LEDOUT0, [0] * (CHANNELS // 4), "outputs")

    def drive(self, currents_ma: Mapping[int, float]) -> None:
        """Duties first, then outputs, and both read back.

        Raises
        ------
        LightError
            The chip does not answer, or lost what was written.
        """
        duties = [self._duty(currents_ma.get(channel, 0.0)) for channel in range(CHANNELS)]
        outputs = packed_outputs({channel: OWN_DUTY for channel, duty in enumerate(duties) if duty})
        subject = "driving channels " + ", ".join(str(channel) for channel, duty in enumerate(duties) if duty)
        self._chip.write(PWM0 | INCREMENT, duties, subject)
        self._chip.write(LEDOUT0 | INCREMENT, outputs, subject)
        prove(self._chip, PWM0, duties, "duties")
        prove(self._chip, LEDOUT0, outputs, "outputs")

    def dark(self) -> None:
        """Every output off."""
        self._chip.write(LEDOUT0 | INCREMENT, [0] * (CHANNELS // 4), "switching all channels off")

    def flags(self) -> dict[int, str]:
        """ "open" by driven channel (over-temperature is folded into the same bits), which shine fully meanwhile."""
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
        """Give the bus back."""
        self._chip.close()

    def _clear_errors(self) -> None:
        self._chip.write(MODE2, [CLEAR_ERRORS], "clearing fault flags")
        self._chip.write(MODE2, [0x00], "watching for faults")

    def _duty(self, current_ma: float) -> int:
        if current_ma <= 0.0:
            return 0
        return min(max(round(current_ma * STEPS / self._full_ma), 1), STEPS - 1)
