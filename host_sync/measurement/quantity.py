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
    offset : by how much the draws' mean lies above the value: noise adds to what it is drawn upon
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
        unit = f" {self.unit}" if self.unit else ""
        if self.value is None:
            return "not defined"
        if self.uncertainty is None:
            return f"{self.value:.4g}{unit}, ± not known"
        places = decimals(self.uncertainty)
        return f"{self.value:.{places}f} ± {self.uncertainty:.{places}f}{unit}"

    @property
    def sentence(self) -> str:
        """Such as "Sa 1.83 ± 0.06 µm (k = 1), 4 % masked"."""
        known = "" if self.uncertainty is None else f" (k = {self.coverage_factor})"
        return f"{self.name} {self.number}{known}, {100.0 * self.masked_share:.2g} % masked"


def decimals(uncertainty: float) -> int:
    """Digits after the point that show two figures of an uncertainty; 4 of none at all."""
    if not 0.0 < uncertainty < float("inf"):
        return 4
    return int(np.clip(1 - np.floor(np.log10(uncertainty)), 0, 9))


def uncertainty_of(value: float, drawn: Float64Array, *, is_direction: bool = False) -> tuple[float, float, int] | None:
    """Standard uncertainty of a number, by how much draws lie above it on average, and how many draws gave a number.

    The uncertainty is the root mean square distance of the draws from the value, not from their own mean: where noise
    raises a number, the number itself has been raised as well, and by about as much as the draws are above it. None
    with too few draws.

    drawn : float64 array of shape (K,), NaN where a draw gave none
    is_direction : an angle in degrees, which is the same after half a turn
    """
    seen = drawn[np.isfinite(drawn)]
    if not np.isfinite(value) or seen.size < max(FEWEST_DRAWS, drawn.size / 2):
        return None
    off = seen - value
    square = float((off**2).mean())
    if is_direction:
        off = (off + 90.0) % 180.0 - 90.0
        square = float((off**2).mean()) + DIRECTION_STEP_DEG**2 / 12.0
    return float(np.sqrt(square)), float(off.mean()), int(seen.size)


def uncertainty_of_uncertainty(draws: int) -> float:
    """Share by which an uncertainty from so many draws may itself be off (k = 1), 1 / sqrt(2 K)."""
    return float(1.0 / np.sqrt(2.0 * draws)) if draws else float("nan")
