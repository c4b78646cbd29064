"""The three lights on a driver chip: names, limits and darkness here, registers in the chip's own file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol, Self

from hal.board_profile import LightFacts
from hal.errors import LightError
from hal.interfaces import LightFault


class LedChip(Protocol):
    """A constant-current LED driver with 16 channels."""

    @property
    def highest_ma(self) -> float:
        """The most that a channel can carry, mA."""
        ...

    def granted_ma(self, current_ma: float) -> float:
        """The current (mA) of the chip's step nearest to the one asked for; 0 only for 0."""
        ...

    def start(self) -> None:
        """Awake, and every channel dark."""
        ...

    def drive(self, currents_ma: Mapping[int, float]) -> None:
        """Drive each named channel with its current (mA), all others dark."""
        ...

    def dark(self) -> None:
        """Every channel off."""
        ...

    def flags(self) -> dict[int, str]:
        """What the chip believes to be wrong, by channel: "open", "short" or "hot"."""
        ...

    def close(self) -> None:
        """Give the bus back."""
        ...


class ChipLights:
    """Three lights on a driver chip; see `hal.interfaces.Lights`."""

    def __init__(self, lights: Sequence[LightFacts], chip: LedChip) -> None:
        self._channels = {light.name: light.channels for light in lights}
        self._chip = chip
        self._driven: dict[int, float] = {}
        self._spare: dict[int, float] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights in R, G, B order."""
        return tuple(self._channels)

    @property
    def highest_ma(self) -> float:
        """The most that a light can be driven with, mA."""
        return self._chip.highest_ma

    def granted_ma(self, currents_ma: Mapping[str, float]) -> dict[str, float]:
        """The chip's nearest steps to these currents (mA).

        Raises
        ------
        LightError
            An unknown name, or a current out of range.
        """
        for name, current in currents_ma.items():
            if name not in self._channels:
                raise LightError(f"there is no light {name!r}: name one of {', '.join(self.names)}")
            if not (math.isfinite(current) and 0.0 <= current <= self._chip.highest_ma):
                raise LightError(
                    f"light {name!r} cannot be driven with {current:g} mA: choose 0 to {self._chip.highest_ma:.3g} mA"
                )
        return {name: self._chip.granted_ma(current) for name, current in currents_ma.items()}

    def switch_on(self, currents_ma: Mapping[str, float]) -> None:
        """Drive each named light with its current (mA); the others go dark.

        Raises
        ------
        LightError
            An unknown name, a current out of range, or a chip that does not answer or does not keep what is written.
        """
        granted = self.granted_ma(currents_ma)
        self._driven = {channel: granted[name] for name in granted for channel in self._channels[name]}
        self._chip.drive(self._driven | self._spare)

    def dark(self) -> None:
        """Every light off; a spare channel that is held stays on."""
        self._driven = {}
        self._chip.dark()
        if self._spare:
            self._chip.drive(self._spare)

    def hold_spare(self, channel: int, current_ma: float) -> None:
        """Drive a channel that belongs to no light with its current (mA) from now on, or with 0 no more.

        Raises
        ------
        LightError
            The chip does not answer; the channel is then not held, and dark with the lights.
        """
        held = {channel: current_ma} if current_ma > 0.0 else {}
        self._spare = {}
        self._chip.drive(self._driven | held)
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
        self._chip.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._driven, self._spare = {}, {}
        try:
            self._chip.dark()
        finally:
            self._chip.close()
