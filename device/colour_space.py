"""How intensity becomes the variables of a polynomial.

A polynomial of low degree bends differently in the logarithm, the root and intensity itself, and errs differently.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, Float64Array

Curve = Literal["log", "root", "linear"]
CURVES: Final[tuple[Curve, ...]] = get_args(Curve)

DARK_OFFSET: Final = 0.05
"""Added to intensity before the logarithm or the root: about the darkest shade that still carries slope."""

RANGE_PERCENT: Final = (0.05, 99.95)
"""Percentiles of the observed colours that variables are clipped to: a polynomial runs away outside."""


def curved(intensity: Float32Array, curve: Curve) -> Float32Array:
    """Intensity along a curve, of the shape of `intensity`."""
    lifted = np.maximum(intensity, np.float32(0.0)) + np.float32(DARK_OFFSET)
    if curve == "log":
        return np.log(lifted)
    return np.sqrt(lifted) if curve == "root" else lifted


@dataclass(frozen=True, slots=True, eq=False)
class ColourSpace:
    """A curve, a clip to what the balls showed, a centre and a scale.

    centre, scale, low, high : float32 arrays of shape (3,), of intensity along the curve
    """

    curve: Curve
    centre: Float32Array
    scale: Float32Array
    low: Float32Array
    high: Float32Array

    @classmethod
    def observed(cls, intensity: Float32Array, curve: Curve) -> ColourSpace:
        """The space of the observed intensities, array of shape (N, 3)."""
        along = curved(intensity, curve)
        low, high = np.percentile(along, RANGE_PERCENT, axis=0)
        fields = (along.mean(axis=0), np.maximum(2.0 * along.std(axis=0), 1e-6), low, high)
        return cls(curve, *(field.astype(np.float32) for field in fields))

    def variables(self, intensity: Float32Array) -> Float32Array:
        """Polynomial variables, of the shape (..., 3) of `intensity`."""
        return (np.clip(curved(intensity, self.curve), self.low, self.high) - self.centre) / self.scale

    def intensity_range(self) -> tuple[Float64Array, Float64Array]:
        """Intensities that variables are clipped to, float64 arrays of shape (3,): lowest and highest."""
        low, high = (bound.astype(np.float64) for bound in (self.low, self.high))
        if self.curve == "log":
            low, high = np.exp(low), np.exp(high)
        elif self.curve == "root":
            low, high = low**2, high**2
        return low - DARK_OFFSET, high - DARK_OFFSET

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as arrays; `from_arrays` is its inverse."""
        named = {name: getattr(self, name) for name in ("centre", "scale", "low", "high")}
        return {"curve": np.array(CURVES.index(self.curve)), **named}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> ColourSpace:
        """The space that `arrays` wrote; KeyError, IndexError or ValueError when it is none."""
        fields = [np.asarray(arrays[name], np.float32).reshape(3) for name in ("centre", "scale", "low", "high")]
        return cls(CURVES[int(arrays["curve"])], *fields)
