"""Colour as variables of a polynomial: its logarithm or itself, clipped to the balls' range and scaled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, Float64Array

DARK_OFFSET: Final = 0.05
"""Added to intensity before the logarithm: about the darkest shade that still carries slope."""

RANGE_PERCENT: Final = (0.05, 99.95)
"""Percentiles of the observed colours that variables are clipped to: a polynomial runs away outside."""


def log_intensity(intensity: Float32Array) -> Float32Array:
    """log(I + DARK_OFFSET), of the shape of `intensity`."""
    return np.log(np.maximum(intensity, np.float32(0.0)) + np.float32(DARK_OFFSET))


@dataclass(frozen=True, slots=True, eq=False)
class FeatureScaler:
    """A clip to what the balls showed, a centre and a scale.

    centre, scale, low, high : float32 arrays of shape (3,), of log intensity, or of colours themselves where `linear`
    linear : whether colours are taken as they are
    """

    centre: Float32Array
    scale: Float32Array
    low: Float32Array
    high: Float32Array
    linear: bool = False

    @classmethod
    def observed(cls, colours: Float32Array, *, linear: bool = False) -> FeatureScaler:
        """Return the space of the observed colours, array of shape (N, 3)."""
        seen = colours if linear else log_intensity(colours)
        low, high = np.percentile(seen, RANGE_PERCENT, axis=0)
        fields = (seen.mean(axis=0), np.maximum(2.0 * seen.std(axis=0), 1e-6), low, high)
        centre, scale, least, most = (field.astype(np.float32) for field in fields)
        return cls(centre, scale, least, most, linear)

    @property
    def spread(self) -> float:
        """Standard deviation of what is clipped over the balls, mean over channels."""
        return 0.5 * float(self.scale.mean())

    def variables(self, colours: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Return the polynomial variables (..., 3), and how far (...) each colour lay outside the range, standard
        deviations."""
        seen = colours if self.linear else log_intensity(colours)
        clipped = np.clip(seen, self.low, self.high)
        excess = np.abs(seen - clipped).max(axis=-1) / np.float32(self.spread)
        return (clipped - self.centre) / self.scale, np.asarray(excess, np.float32)

    def intensity_range(self) -> tuple[Float64Array, Float64Array]:
        """Return intensities that a space of intensity clips to, float64 arrays of shape (3,): lowest and highest."""
        low, high = (np.exp(bound.astype(np.float64)) - DARK_OFFSET for bound in (self.low, self.high))
        return low, high

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays but `linear`, which goes with what is read; `from_arrays` is its inverse."""
        return {name: getattr(self, name) for name in ("centre", "scale", "low", "high")}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], *, linear: bool = False) -> FeatureScaler:
        """Return the space that `arrays` wrote; KeyError or ValueError when malformed."""
        centre, scale, low, high = (
            np.asarray(arrays[name], np.float32).reshape(3) for name in ("centre", "scale", "low", "high")
        )
        return cls(centre, scale, low, high, linear)
