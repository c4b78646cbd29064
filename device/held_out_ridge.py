"""Ridge regression of slope whose every judgement comes from balls that it did not see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.inverse_map import slope_from_stereographic, stereographic_from_slope
from device.surface import Float64Array, MaskArray

FOLDS: Final = 5


@dataclass(slots=True, eq=False)
class HeldOutRidge:
    """The regression problem; `slope` and `weight` may be replaced between solutions.

    design : float64 array of shape (N, F), features
    flat_gram : float64 array of shape (F, F), Gram matrix of untouched skin, whose slope is 0
    slope : float64 array of shape (N, 2), true slopes
    weight : float64 array of shape (N,)
    ball : int array of shape (N,), the ball that each row belongs to
    """

    design: Float64Array
    flat_gram: Float64Array
    slope: Float64Array
    weight: Float64Array
    ball: NDArray[np.intp]

    def solve(self, penalty: float, balls: MaskArray) -> Float64Array:
        """Coefficients of shape (F, 2) learned from the balls that the mask marks."""
        gram, moment = self._normal_equations(balls)
        return self._ridge(gram, moment, penalty)

    def held_out_slopes(self, penalties: Sequence[float], alive: MaskArray) -> list[Float64Array]:
        """Slopes of shape (N, 2), one array a penalty; each ball predicted from the living balls of other folds."""
        fold = np.arange(len(alive)) % min(FOLDS, len(alive))
        predictions = [np.zeros_like(self.slope) for _ in penalties]
        for number in range(int(fold.max()) + 1):
            gram, moment = self._normal_equations(alive & (fold != number))
            rows = (fold == number)[self.ball]
            for penalty, prediction in zip(penalties, predictions, strict=True):
                u = self.design[rows] @ self._ridge(gram, moment, penalty)
                prediction[rows] = slope_from_stereographic(u)
        return predictions

    def _normal_equations(self, balls: MaskArray) -> tuple[Float64Array, Float64Array]:
        rows = balls[self.ball]
        design = self.design[rows]
        weighted = design * self.weight[rows, None]
        target = stereographic_from_slope(self.slope[rows, 0], self.slope[rows, 1])
        return weighted.T @ design + self.flat_gram * rows.mean(), weighted.T @ target

    def _ridge(self, gram: Float64Array, moment: Float64Array, penalty: float) -> Float64Array:
        scaled = penalty * len(self.ball) / 100.0
        return np.asarray(np.linalg.solve(gram + scaled * np.eye(len(gram)), moment))


def angle_between_deg(slope: Float64Array, truth: Float64Array) -> Float64Array:
    """Angle between the normals of slopes of shape (N, 2), degrees, shape (N,)."""
    dot = (slope * truth).sum(axis=-1) + 1.0
    norms = np.sqrt((1.0 + (slope**2).sum(axis=-1)) * (1.0 + (truth**2).sum(axis=-1)))
    return np.asarray(np.degrees(np.arccos(np.clip(dot / norms, -1.0, 1.0))))


def robust_weight(slope: Float64Array, truth: Float64Array) -> Float64Array:
    """Weights of shape (N,), mean 1, that turn the next least-squares pass towards least absolute error."""
    residual = np.linalg.norm(stereographic_from_slope(*slope.T) - stereographic_from_slope(*truth.T), axis=1)
    weight = 1.0 / np.maximum(residual, max(0.5 * float(np.median(residual)), 1e-6))
    return np.asarray(weight / weight.mean())
