"""Three lights on a driver chip: names, limits and switching off; registers are in the chip's own file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Final, Protocol, Self

from hal.board_profile import LightConfig
from hal.drivers.i2c_bus import I2cChip
from hal.errors import HalError, LightError
from hal.interfaces import LightFault


class LedChip(Protocol):
    """A constant-current LED driver with 16 channels."""

    @property
    def max_ma(self) -> float:
        """Maximum current of a channel, mA."""
        ...

    def granted_ma(self, current_ma: float) -> float:
        """Return the chip's nearest step of current (mA); 0 only for 0."""
        ...

    def start(self) -> None:
        """Wake the chip with every channel off."""
        ...

    def drive(self, currents_ma: Mapping[int, float]) -> None:
        """Drive each named channel with its current (mA), all others off."""
        ...

    def off(self) -> None:
        """Every channel off."""
        ...

    def flags(self) -> dict[int, str]:
        """Return faults that the chip reports, by channel: "open", "short" or "hot"."""
        ...

    def close(self) -> None:
        """Release the bus."""
        ...


CHANNELS: Final = 16


INCREMENT: Final = 0x80
"""Bit of the control byte that makes a transfer auto-increment through all registers."""


def packed_outputs(states: Mapping[int, int]) -> list[int]:
    """LEDOUT registers: two bits per channel, four channels per register."""
    packed = [0] * (CHANNELS // 4)
    for channel, state in states.items():
        packed[channel // 4] |= state << 2 * (channel % 4)
    return packed


def verify_registers(chip: I2cChip, register: int, written: list[int], what: str) -> None:
    """Read back what was written.

    Raises
    ------
    LightError
        The chip does not answer, or holds other values.
    """
    found = list(chip.read(register | INCREMENT, len(written), what))
    if found != written:
        raise LightError(
            f"the {chip.place} did not keep its {what} (wrote {written}, reads {found}): "
            "check its supply for dips, and that this chip is at this address"
        )


def drive_outputs(chip: I2cChip, values: tuple[int, list[int], str], first_output: int, on_state: int) -> None:
    """Write one value per channel, then switch on the channels whose value is not 0; read both back.

    values : first register, value of each channel, and their name in errors
    first_output : first LEDOUT register
    on_state : output state of a channel that is on

    Raises
    ------
    LightError
        The chip does not answer, or lost what was written.
    """
    first, levels, name = values
    outputs = packed_outputs({channel: on_state for channel, level in enumerate(levels) if level})
    subject = "driving channels " + ", ".join(str(channel) for channel, level in enumerate(levels) if level)
    chip.write(first | INCREMENT, levels, subject)
    chip.write(first_output | INCREMENT, outputs, subject)
    verify_registers(chip, first, levels, name)
    verify_registers(chip, first_output, outputs, "outputs")


class ChipLights:
    """Three lights on a driver chip; see `hal.interfaces.Lights`.

    gate : lets the chip's outputs through; by default they follow its registers alone
    """

    def __init__(self, lights: Sequence[LightConfig], chip: LedChip, gate: LightGate | None = None) -> None:
        self._channels = {light.name: light.channels for light in lights}
        self._max_ma = {light.name: min(light.max_ma or chip.max_ma, chip.max_ma) for light in lights}
        self._chip = chip
        self._gate = gate or LightGate()
        self._driven: dict[int, float] = {}
        self._spare: dict[int, float] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights in R, G, B order."""
        return tuple(self._channels)

    @property
    def max_ma(self) -> float:
        """Largest current allowed for every light, mA: the smaller limit of its LEDs and of the chip."""
        return min(self._max_ma.values())

    def granted_ma(self, currents_ma: Mapping[str, float]) -> dict[str, float]:
        """Return the chip's nearest steps to these currents (mA).

        Raises
        ------
        LightError
            An unknown name, or a current out of range.
        """
        for name, current in currents_ma.items():
            if name not in self._channels:
                raise LightError(f"unknown light {name!r}: name one of {', '.join(self.names)}")
            if not (math.isfinite(current) and 0.0 <= current <= self._max_ma[name]):
                raise LightError(
                    f"light {name!r} cannot be driven with {current:g} mA: choose 0 to {self._max_ma[name]:.3g} mA"
                )
        return {name: self._granted_ma(name, current) for name, current in currents_ma.items()}

    def _granted_ma(self, name: str, current_ma: float) -> float:
        """Return the chip's step nearest to the request that does not exceed the light's limit, mA."""
        granted = self._chip.granted_ma(current_ma)
        if granted <= self._max_ma[name] * (1.0 + 1e-9):
            return granted
        return self._chip.granted_ma(max(2.0 * self._max_ma[name] - granted, 0.0))

    def switch_on(self, currents_ma: Mapping[str, float]) -> None:
        """Drive each named light with its current (mA); all others are off.

        Raises
        ------
        LightError
            An unknown name, a current out of range, or a chip that does not answer or does not keep what is written.
        """
        granted = self.granted_ma(currents_ma)
        self._driven = {channel: granted[name] for name in granted for channel in self._channels[name]}
        self._chip.drive(self._driven | self._spare)
        self._gate.shine(any(self._driven.values()) or bool(self._spare))

    def off(self) -> None:
        """Switch every light off; a held spare channel stays on."""
        self._driven = {}
        try:
            self._gate.shine(bool(self._spare))
        finally:
            self._chip.off()
        if self._spare:
            self._chip.drive(self._spare)

    def hold_spare(self, channel: int, current_ma: float) -> None:
        """Hold a channel that belongs to no light at this current (mA), or release it with 0.

        Raises
        ------
        LightError
            The chip does not answer; the channel is then not held, and off with the lights.
        """
        held = {channel: current_ma} if current_ma > 0.0 else {}
        self._spare = {}
        self._chip.drive(self._driven | held)
        self._gate.shine(any(self._driven.values()) or bool(held))
        self._spare = held

    def faults(self) -> tuple[LightFault, ...]:
        """Advisory flags of the lights, each light and kind once."""
        flags = self._chip.flags()
        found = [
            LightFault(name, flags[channel])
            for name, channels in self._channels.items()
            for channel in channels
            if channel in flags
        ]
        return tuple(dict.fromkeys(found))

    def __enter__(self) -> Self:
        try:
            self._gate.wake()
        except HalError:
            # Without the line the registers can still make dark.
            with suppress(LightError):
                self._chip.off()
            self._chip.close()
            raise
        self._chip.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._driven, self._spare = {}, {}
        try:
            self._chip.off()
        finally:
            try:
                self._gate.close()
            finally:
                self._chip.close()


# The line that lets a light driver's outputs through: with nobody at the line a pull keeps the skin dark and cool.


class SwitchedLine(Protocol):
    """An output line."""

    def switch(self, on: bool) -> None:
        """Drive the line; the first call requests it."""
        ...

    def release(self) -> None:
        """Release the line."""
        ...


class LightGate:
    """Output enable of a PCA9955B, open only while something shines; or reset of a TLC59116, which then forgets all.

    Parameters
    ----------
    line : None where the pin is tied, and the outputs follow the registers alone
    holds_reset : the line keeps the chip in reset, so it stays open from `wake` to `close`
    """

    def __init__(self, line: SwitchedLine | None = None, *, holds_reset: bool = False) -> None:
        self._line = line
        self._holds_reset = holds_reset

    def wake(self) -> None:
        """Before the chip is first written: out of reset, or dark."""
        if self._line is not None:
            self._line.switch(self._holds_reset)

    def shine(self, lit: bool) -> None:
        """Let the outputs through, or not."""
        if self._line is not None and not self._holds_reset:
            self._line.switch(lit)

    def close(self) -> None:
        """Dark, and the line released to its pull."""
        if self._line is not None:
            try:
                self._line.switch(False)
            finally:
                self._line.release()
