"""Distance of a pixel's colour and place from the training pixels: the leverage of ridge regression.

A polynomial's answer has the variance h = φᵀ (ΦᵀΦ + λ)⁻¹ φ times that of the samples, φ the pixel's features. Where h
is larger than at any ball the answer is extrapolated, however smooth it looks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.inverse_map.regressor import FeatureRegressor
from device.surface.fields import Float32Array, Float64Array

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
        """Return the leverage (N,) of colours (N, 3) at position variables (N, 2), in units of the highest of the
        training pixels.
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
