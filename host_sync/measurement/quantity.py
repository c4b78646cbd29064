"""A number with its unit and uncertainty, and how such a number is written."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

from device.surface import Float64Array

FEWEST_DRAWS: Final = 4
NOISE_DOUBT: Final = 0.5
NOISE_SHARE: Final = 0.05
"""Shares of the uncertainty and of the value that lie all to one side: from both on, noise makes a number doubtful."""

DIRECTION_STEP_DEG: Final = 0.5
"""Directions are told in steps of so much."""


class Quantity(msgspec.Struct, frozen=True, kw_only=True):
    """One measured number.

    subject : the surface, or the recipe's name of a line, place or region
    name, unit : which number of it; a pure number has an empty unit
    value : None where it is not defined
    uncertainty : coverage factor times standard uncertainty; None where the result holds no draws
    coverage_factor : k
    offset : by how much noise of the measurement has raised the value, as the draws tell; it is not taken off
    draws : number of draws that gave a number
    masked_share : share of what was measured without a height
    doubts : what speaks against the number
    """

    subject: str
    name: str
    unit: str
    value: float | None
    uncertainty: float | None
    coverage_factor: int
    offset: float | None
    draws: int
    masked_share: float
    doubts: tuple[str, ...] = ()

    @property
    def number(self) -> str:
        """Such as "1.83 ± 0.06 µm": two digits of the uncertainty, the value to the same place."""
        if self.value is None:
            return "not defined"
        factor, name = shown_in(self.unit, self.value)
        unit = f" {name}" if name else ""
        if self.uncertainty is None:
            return f"{factor * self.value:.4g}{unit}, ± not known"
        places = decimals(factor * self.uncertainty)
        value, uncertainty = (round(factor * one, places) for one in (self.value, self.uncertainty))
        shown = max(places, 0)
        return f"{value:.{shown}f} ± {uncertainty:.{shown}f}{unit}"

    @property
    def sentence(self) -> str:
        """Such as "Sa 1.83 ± 0.06 µm (k = 1), 4 % masked"."""
        known = "" if self.uncertainty is None else f" (k = {self.coverage_factor})"
        return f"{self.name} {self.number}{known}, {100.0 * self.masked_share:.2g} % masked"


def shown_in(unit: str, value: float) -> tuple[float, str]:
    """The unit in which a number is shown, and the factor to it: volumes from a hundredth of a mm³ on in mm³."""
    return (1e-9, "mm³") if unit == "µm³" and abs(value) >= 1e7 else (1.0, unit)


def decimals(uncertainty: float) -> int:
    """Digits after the point that show two figures of an uncertainty, less than 0 of a large one; 4 of none at all."""
    if not 0.0 < uncertainty < float("inf"):
        return 4
    return int(np.clip(1 - np.floor(np.log10(uncertainty)), -12, 9))


def uncertainty_of(value: float, drawn: Float64Array, *, is_direction: bool = False) -> tuple[float, float, int] | None:
    """Standard uncertainty of a number, by how much noise has raised it, and how many draws gave a number.

    The draws' spread about their own mean, and beside it, in squares, what noise has raised the number by: that is not
    taken off the number. None with too few draws.

    drawn : float64 array of shape (K,), NaN where a draw gave none
    is_direction : an angle in degrees, which is the same after half a turn
    """
    seen = drawn[np.isfinite(drawn)]
    if not np.isfinite(value) or seen.size < max(FEWEST_DRAWS, drawn.size / 2):
        return None
    off = seen - value
    if is_direction:
        off = (off + 90.0) % 180.0 - 90.0
        return float(np.sqrt((off**2).mean() + DIRECTION_STEP_DEG**2 / 12.0)), float(off.mean()), int(seen.size)
    raised = raised_by(value, float(off.mean()))
    return float(np.hypot(off.std(), raised)), raised, int(seen.size)


def raised_by(value: float, offset: float) -> float:
    """By how much noise has raised a number that as much noise again raises by `offset`.

    Noise and surface add in squares (Sq² = surface² + noise²), so that the first noise raised it by more than the next
    does: of a surface that is flat and shows nothing but noise, by the whole of the number. What lowers a number, or
    has another sign, is taken as it is.
    """
    if not offset > 0.0:
        return offset
    square = value**2 - 2.0 * abs(value) * offset - offset**2
    return offset if value <= 0.0 else value - float(np.sqrt(max(square, 0.0)))


def uncertainty_of_uncertainty(draws: int) -> float:
    """Share by which an uncertainty from so many draws may itself be off (k = 1), 1 / sqrt(2 K)."""
    return float(1.0 / np.sqrt(2.0 * draws)) if draws else float("nan")
