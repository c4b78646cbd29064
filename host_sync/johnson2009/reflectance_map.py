"""Reflectance maps: observed intensities of balls on a fixed grid of slopes (paper, section 5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import BallSamples
from device.errors import CalibrationError
from device.surface.fields import Float32Array, Float64Array, MaskArray

CELLS: Final = 97
"""Cells along each axis of the slope grid; odd, so that one cell is centred on the flat skin."""

SLOPE_PERCENTILE: Final = 99.9
"""Percentile of the observed slopes that the grid must cover: a single steep pixel must not coarsen it."""

MIN_CELLS: Final = 60
"""Observed cells needed to determine the 36 harmonics of order 5."""


@dataclass(frozen=True, slots=True, eq=False)
class ReflectanceMaps:
    """Observed intensity by slope, one map per channel; rows of a map are q, columns are p.

    reach : slope at the outer border of the grid, which spans -reach to reach in p and q
    mean : float64 array of shape (CELLS, CELLS, 3), NaN where nothing was observed
    variance : float64 array of shape (CELLS, CELLS, 3), within a cell, NaN with fewer than two pixels
    count : int array of shape (CELLS, CELLS), pixels
    """

    reach: float
    mean: Float64Array
    variance: Float64Array
    count: NDArray[np.int64]

    @property
    def cell(self) -> float:
        """Width of a cell, slope."""
        return 2.0 * self.reach / len(self.count)

    @property
    def centres(self) -> Float64Array:
        """Slopes at the centres of the cells along either axis, float64 array of shape (CELLS,)."""
        return np.asarray((np.arange(len(self.count)) + 0.5) * self.cell - self.reach, np.float64)

    @property
    def observed(self) -> MaskArray:
        """True where a cell holds a pixel, shape (CELLS, CELLS)."""
        return np.asarray(self.count > 0)

    @property
    def scatter(self) -> Float64Array:
        """Standard deviation of intensity at one slope, pooled over cells, float64 array of shape (3,).

        It includes everything that slope does not explain: pixel noise, texture of the skin, position in the field.
        """
        seen = self.count > 1
        freedom = (self.count[seen] - 1)[:, None]
        pooled = (self.variance[seen] * freedom).sum(axis=0) / max(float(freedom.sum()), 1.0)
        return np.asarray(np.sqrt(pooled), np.float64)


def sample_reflectance(samples: BallSamples) -> ReflectanceMaps:
    """Return the mean, variance and count of intensity in every cell of the slope grid.

    Raises
    ------
    CalibrationError
        The balls show too few different slopes.
    """
    reach = _reach(samples.p, samples.q)
    cell = 2.0 * reach / CELLS
    column, row = (np.floor((slope + reach) / cell).astype(np.intp) for slope in (samples.p, samples.q))
    inside = (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
    index = row[inside] * CELLS + column[inside]
    count = np.bincount(index, minlength=CELLS * CELLS)
    mean, variance = _moments(index, samples.intensity[inside], count)
    maps = ReflectanceMaps(reach, mean, variance, count.reshape(CELLS, CELLS))
    seen = int(maps.observed.sum())
    if seen < MIN_CELLS:
        raise CalibrationError(
            f"the balls show only {seen} different slopes: press the ball deeper and calibrate again"
        )
    return maps


def _reach(p: Float32Array, q: Float32Array) -> float:
    if len(p) == 0:
        raise CalibrationError("no usable pixel inside a ball's contact: lower the exposure and calibrate again")
    steepest = float(np.percentile(np.hypot(p, q), SLOPE_PERCENTILE))
    return max(1.02 * steepest, 1e-3)


def _moments(index: NDArray[np.intp], values: Float32Array, count: NDArray[np.int64]) -> tuple[Float64Array, ...]:
    """Return the mean and unbiased variance by cell, each of shape (CELLS, CELLS, 3)."""
    shape = (CELLS, CELLS, 3)
    mean, variance = np.full((count.size, 3), np.nan), np.full((count.size, 3), np.nan)
    some, several = count > 0, count > 1
    for channel in range(3):
        value = values[:, channel].astype(np.float64)
        mean[some, channel] = np.bincount(index, value, minlength=count.size)[some] / count[some]
        square = np.bincount(index, (value - mean[index, channel]) ** 2, minlength=count.size)
        variance[several, channel] = square[several] / (count[several] - 1)
    return mean.reshape(shape), variance.reshape(shape)
