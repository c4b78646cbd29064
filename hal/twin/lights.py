"""The twin's lights: a view of the bench."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Self

from hal.errors import LightError
from hal.interfaces import LightFault
from hal.twin.bench import Bench

HIGHEST_CURRENT_MA: Final = 57.0


class TwinLights:
    """Three lights set by current; see `hal.interfaces.Lights`."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights in R, G, B order."""
        return tuple(light.name for light in self._bench.profile.lights)

    @property
    def highest_ma(self) -> float:
        """The most that a light can be driven with, mA."""
        return HIGHEST_CURRENT_MA

    def granted_ma(self, currents_ma: Mapping[str, float]) -> dict[str, float]:
        """The same currents (mA): the twin has no steps.

        Raises
        ------
        LightError
            An unknown name, or a current out of range.
        """
        for name, current in currents_ma.items():
            if name not in self.names:
                raise LightError(f"there is no light {name!r}: name one of {', '.join(self.names)}")
            if not 0.0 <= current <= HIGHEST_CURRENT_MA:
                raise LightError(
                    f"light {name!r} cannot be driven with {current:g} mA: choose 0 to {HIGHEST_CURRENT_MA:g} mA"
                )
        return dict(currents_ma)

    def switch_on(self, currents_ma: Mapping[str, float]) -> None:
        """Drive each named light with its current (mA); the others go dark.

        Raises
        ------
        LightError
            An unknown name, a current out of range, or a silent driver.
        """
        self.granted_ma(currents_ma)
        self._check_answering()
        self._bench.drive(currents_ma)

    def dark(self) -> None:
        """Every light off."""
        self._check_answering()
        self._bench.drive({})

    def faults(self) -> tuple[LightFault, ...]:
        """An "open" for every light that is broken."""
        self._check_answering()
        faults = self._bench.faults
        open_lights = self.names if faults.lights_broken else [n for n in self.names if n in faults.open_lights]
        return tuple(LightFault(name, "open") for name in open_lights)

    def __enter__(self) -> Self:
        self.dark()
        return self

    def __exit__(self, *exc: object) -> None:
        self.dark()

    def _check_answering(self) -> None:
        if self._bench.faults.lights_silent:
            raise LightError("the twin's light driver does not acknowledge: check its address, wiring and supply")
