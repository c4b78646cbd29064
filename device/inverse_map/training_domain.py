"""Colours that the balls showed, and the distance of any other colour from them.

Colours of a frame made with other lights, or turned, lie where those of the balls do not, channel by channel in range
though they may be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.inverse_map.regressor import FeatureRegressor, log_intensity
from device.surface import Float32Array, Float64Array

CELL: Final = 0.1
"""Width of a cell of colour, standard deviations of log intensity over the balls."""

MARGIN: Final = 0.8
"""The table reaches this far beyond the observed colours, standard deviations; farther is added up."""

MAX_CELLS: Final = 96
"""Cells along one colour; wider ranges get wider cells."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingDomain:
    """Distance of every colour to the nearest that a ball showed.

    low : float32 array of shape (3,), log intensity at the centre of the first cell
    cell : width of a cell, log intensity
    spread : standard deviation of log intensity over the balls, mean over channels: the unit of distance
    distance : float32 array of shape (A, B, C), 0 in cells that a ball showed
    """

    low: Float32Array
    cell: float
    spread: float
    distance: Float32Array

    @classmethod
    def observed(cls, intensity: Float32Array) -> TrainingDomain:
        """Return the domain of the observed intensities, array of shape (N, 3), and of untouched skin."""
        from scipy.ndimage import distance_transform_edt  # here, because only calibrating needs it

        logs = log_intensity(np.concatenate([intensity, np.ones((1, 3), np.float32)]))
        spread = max(float(logs.std(axis=0).mean()), 1e-3)
        low = logs.min(axis=0) - np.float32(MARGIN * spread)
        high = logs.max(axis=0) + np.float32(MARGIN * spread)
        cell = max(CELL * spread, float((high - low).max()) / (MAX_CELLS - 2))
        shape = np.ceil((high - low) / cell).astype(np.intp) + 1
        seen = np.zeros(shape, np.bool_)
        index = ((logs - low) / np.float32(cell) + np.float32(0.5)).astype(np.intp)
        seen[tuple(index.T)] = True
        distance = distance_transform_edt(~seen) * (cell / spread)
        return cls(low.astype(np.float32), cell, spread, np.asarray(distance, np.float32))

    def excess(self, intensity: Float32Array) -> Float32Array:
        """Return the distance of intensities (..., 3) to what the balls showed, standard deviations, (...)."""
        at = (log_intensity(intensity) - self.low) / np.float32(self.cell)
        last = np.array(self.distance.shape, np.float32) - np.float32(1.0)
        inside = np.clip(at, np.float32(0.0), last)
        beyond = np.abs(at - inside).max(axis=-1) * np.float32(self.cell / self.spread)
        index = (inside + np.float32(0.5)).astype(np.intp)
        return np.asarray(self.distance[index[..., 0], index[..., 1], index[..., 2]] + beyond, np.float32)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        return {"low": self.low, "widths": np.array([self.cell, self.spread]), "distance": self.distance}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> TrainingDomain:
        """Return the domain that `arrays` wrote; KeyError or ValueError when malformed."""
        cell, spread = (float(width) for width in arrays["widths"])
        distance = np.asarray(arrays["distance"], np.float32)
        if distance.ndim != 3:
            raise ValueError(f"a training domain of {distance.ndim} dimensions, not 3")
        return cls(np.asarray(arrays["low"], np.float32).reshape(3), cell, spread, distance)


# Distance of a pixel's colour and place from the training pixels: the leverage of ridge regression.
#
# A polynomial's answer has the variance h = φᵀ (ΦᵀΦ + λ)⁻¹ φ times that of the samples, φ the pixel's features. Where h
# is larger than at any ball the answer is extrapolated, however smooth it looks.

TRAINED_PERCENT: Final = 99.9
"""Percentile of the leverage over the balls that counts as trained: the last few pixels are dust."""


@dataclass(frozen=True, slots=True, eq=False)
class Leverage:
    """Square root of the covariance of a curve's coefficients, which gives the leverage of its features.

    root : float32 array of shape (M K, M K); h = |φᵀ root|² for features φ of the curve
    trained : the highest leverage that counts as trained
    """

    root: Float32Array
    trained: float

    @classmethod
    def of(cls, root: Float64Array, balls: Float64Array) -> Leverage:
        """Return the leverage whose root over features is known, and its values (N,) at the pixels of balls."""
        return cls(root.astype(np.float32), float(np.percentile(balls, TRAINED_PERCENT)))

    def relative(self, curve: FeatureRegressor, colours: Float32Array, place: Float64Array) -> Float64Array:
        """Return the leverage (N,) of colours (N, 3) over the highest of the training pixels.

        place : position variables (N, 2)
        """
        design = curve.design(colours, place)
        return np.asarray(((design.astype(np.float32) @ self.root) ** 2).sum(axis=1) / self.trained, np.float64)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        return {"root": self.root, "taught": np.array(self.trained)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], curve: FeatureRegressor) -> Leverage:
        """Return the leverage of `curve` that `arrays` wrote; KeyError or ValueError when malformed."""
        root = np.asarray(arrays["root"], np.float32)
        features = curve.coefficients.shape[0] * curve.coefficients.shape[1]
        trained = float(arrays["taught"])
        if root.shape != (features, features) or not trained > 0.0:
            raise ValueError(f"a leverage of shape {root.shape} for {features} features")
        return cls(root, trained)
