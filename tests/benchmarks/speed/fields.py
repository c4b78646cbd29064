"""Gradient fields with a known surface, in pixels: input of the integrators."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, GradientField, full_rectangle

SLOPE_NOISE = 0.02
"""Standard deviation of a slope's noise where the weight is 1."""

MIN_WEIGHT = 0.1
HOLES = 40
LOOSE_PIXELS = 0.005
"""Fraction of single pixels that are missing besides the holes."""

Profile = NDArray[np.float64]
"""A function of one variable and, in the second row, its derivative: float64 array of shape (2, N)."""


@dataclass(frozen=True, eq=False)
class KnownField:
    """Slopes with noise, and the surface they belong to.

    truth_px : float32 array of shape (H, W), heights in pixels
    gradients : its slopes with noise, their validity and weights
    """

    truth_px: Float32Array
    gradients: GradientField

    def rmse_px(self, z: NDArray[Any]) -> float:
        """Root mean square error of heights (px) on valid pixels, each set to mean zero."""
        used = self.gradients.valid
        error = z[used].astype(np.float64) - self.truth_px[used]
        return float(error.std())


def plain_field(shape: tuple[int, int], seed: int = 0) -> KnownField:
    """A full rectangle without weights."""
    truth, p, q = _surface(shape)
    rng = np.random.default_rng(seed)
    for slope in (p, q):
        slope += SLOPE_NOISE * rng.standard_normal(shape, np.float32)
    return KnownField(truth, full_rectangle(p, q))


def holed_field(shape: tuple[int, int], seed: int = 0) -> KnownField:
    """The same surface with weights 1 / variance between `MIN_WEIGHT` and 1, round holes and missing pixels."""
    truth, p, q = _surface(shape)
    rng = np.random.default_rng(seed)
    weight = rng.uniform(MIN_WEIGHT, 1.0, shape).astype(np.float32)
    for slope in (p, q):
        slope += SLOPE_NOISE * rng.standard_normal(shape, np.float32) / np.sqrt(weight)
    valid = rng.random(shape, np.float32) >= LOOSE_PIXELS
    for _ in range(HOLES):
        _cut_disc(valid, rng)
    _close_islands(valid)
    weight[~valid] = 0.0
    return KnownField(truth, GradientField(p, q, valid, weight))


def _surface(shape: tuple[int, int]) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Height (px) and slopes of a surface that is not periodic: a bowl, waves and bumps, sums of products."""
    rows, columns = shape
    y, x = np.arange(rows) / columns, np.arange(columns) / columns
    terms = [(0.15 * _bowl(y), _ones(x)), (_ones(y), 0.2 * _bowl(x))]
    terms.append((_wave(y, 2.3, 0.4), _wave(x, 3.1, 0.2, 0.03)))
    terms.append((_wave(y, 11.7, 1.1), _wave(x, 9.2, 0.9, 0.004)))
    for row, column, width, height in ((0.2, 0.3, 0.05, 0.02), (0.5, 0.7, 0.02, 0.008), (0.65, 0.2, 0.01, -0.003)):
        terms.append((_bump(y, row, width), height * _bump(x, column, width)))
    z, p, q = (np.zeros(shape, np.float32) for _ in range(3))
    for down, across in terms:
        z += np.outer(columns * down[0], across[0]).astype(np.float32)
        p += np.outer(down[0], across[1]).astype(np.float32)
        q += np.outer(down[1], across[0]).astype(np.float32)
    return z, p, q


def _ones(at: NDArray[np.float64]) -> Profile:
    return np.stack([np.ones_like(at), np.zeros_like(at)])


def _bowl(at: NDArray[np.float64]) -> Profile:
    return np.stack([at * at, 2.0 * at])


def _wave(at: NDArray[np.float64], cycles: float, phase: float, height: float = 1.0) -> Profile:
    turn = 2.0 * np.pi * cycles
    return height * np.stack([np.sin(turn * at + phase), turn * np.cos(turn * at + phase)])


def _bump(at: NDArray[np.float64], centre: float, width: float) -> Profile:
    bell = np.exp(-0.5 * ((at - centre) / width) ** 2)
    return np.stack([bell, -(at - centre) / width**2 * bell])


def _cut_disc(valid: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """Mark a round hole of up to a twentieth of the width as invalid."""
    rows, columns = valid.shape
    radius = int(rng.uniform(0.005, 0.05) * columns) + 1
    row, column = int(rng.uniform(0, rows)), int(rng.uniform(0, columns))
    top, left = max(row - radius, 0), max(column - radius, 0)
    part = valid[top : row + radius + 1, left : column + radius + 1]
    y, x = np.ogrid[: part.shape[0], : part.shape[1]]
    part[(y + top - row) ** 2 + (x + left - column) ** 2 <= radius**2] = False


def _close_islands(valid: NDArray[np.bool_]) -> None:
    """Mark all but the largest connected component as invalid: one mean, one error."""
    _, labels, facts, _ = cv2.connectedComponentsWithStats(valid.astype(np.uint8), connectivity=4)
    valid &= labels == 1 + int(np.argmax(facts[1:, cv2.CC_STAT_AREA]))
