"""Heights along a line, with what is known of their errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array
from host_sync.errors import ViewError

MOST_POINTS: Final = 20_000
NEAREST_WHOLE: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Line:
    """A line between two places of a height map, in pixels; (0, 0) is the centre of the first."""

    row_0: float
    column_0: float
    row_1: float
    column_1: float

    @property
    def length_px(self) -> float:
        """From end to end."""
        return float(np.hypot(self.row_1 - self.row_0, self.column_1 - self.column_0))


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Heights at equal steps of at most a pixel.

    rows, columns : float64 arrays of shape (N,), where they were taken, px
    distance_um : float64 array of shape (N,), from the line's beginning
    z_um : float64 array of shape (N,), NaN where a pixel beside is invalid
    sigma_um : float64 array of shape (N,), standard uncertainty of each height above untouched skin; None when unknown
    draws_um : float64 array of shape (K, N), errors of this line that the data allow; None when they were not kept
    """

    rows: NDArray[np.float64]
    columns: NDArray[np.float64]
    distance_um: NDArray[np.float64]
    z_um: NDArray[np.float64]
    sigma_um: NDArray[np.float64] | None
    draws_um: NDArray[np.float64] | None

    def difference_sigma_um(self, first: int, last: int) -> float | None:
        """Standard uncertainty of z[last] - z[first]; smaller than that of either, as most of their error is one."""
        if self.draws_um is None:
            return None
        return float(np.sqrt(np.mean((self.draws_um[:, last] - self.draws_um[:, first]) ** 2)))


def profile(
    z_um: Float32Array,
    pitch_um: float,
    line: Line,
    draws_um: Float32Array | None = None,
    sigma_um: Float32Array | None = None,
) -> Profile:
    """The profile along a line; along a row or a column it is the array itself.

    draws_um : float32 array of shape (K, h, w), height errors over the field reduced
    sigma_um : float32 array of shape (H, W), taken where there are no draws

    Raises
    ------
    ViewError
        The line has no length, or leaves the height map.
    """
    rows, columns = _places(line, (z_um.shape[0], z_um.shape[1]))
    length_um = line.length_px * pitch_um
    errors = None if draws_um is None else _drawn(draws_um, rows, columns, (z_um.shape[0], z_um.shape[1]))
    if errors is not None:
        known = np.sqrt(np.mean(errors**2, axis=0))
    else:
        known = None if sigma_um is None else _between(sigma_um, rows, columns)
    return Profile(
        rows=rows,
        columns=columns,
        distance_um=np.linspace(0.0, length_um, len(rows)),
        z_um=_between(z_um, rows, columns),
        sigma_um=known,
        draws_um=errors,
    )


def _places(line: Line, shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    ends = np.array([[line.row_0, line.row_1], [line.column_0, line.column_1]])
    if not np.isfinite(ends).all() or (ends < 0).any() or (ends.max(axis=1) > np.array(shape) - 1).any():
        raise ViewError("the profile leaves the height map: draw it inside")
    if not line.length_px > 0:
        raise ViewError("the profile has no length: draw it from one place to another")
    count = min(int(np.ceil(line.length_px - NEAREST_WHOLE)) + 1, MOST_POINTS)
    return np.linspace(line.row_0, line.row_1, count), np.linspace(line.column_0, line.column_1, count)


def _between(values: Float32Array, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bilinear between pixels; a pixel that does not count is not looked at, even if it is invalid."""
    row, column = np.floor(rows).astype(int), np.floor(columns).astype(int)
    down, right = rows - row, columns - column
    total = np.zeros(len(rows))
    for step_row, share_row in ((0, 1.0 - down), (1, down)):
        for step_column, share_column in ((0, 1.0 - right), (1, right)):
            share = share_row * share_column
            there = share > NEAREST_WHOLE
            at_row = np.minimum(row + step_row, values.shape[0] - 1)
            at_column = np.minimum(column + step_column, values.shape[1] - 1)
            total[there] += share[there] * values[at_row[there], at_column[there]]
    return total


def _drawn(
    draws_um: Float32Array, rows: NDArray[np.float64], columns: NDArray[np.float64], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """The draws along the line: their cells cover several pixels each."""
    factor_rows, factor_columns = shape[0] / draws_um.shape[1], shape[1] / draws_um.shape[2]
    down = ((rows + 0.5) / factor_rows - 0.5).astype(np.float32)[None]
    right = ((columns + 0.5) / factor_columns - 0.5).astype(np.float32)[None]
    step = 4096  # cv2.remap takes no more than 32767 places a line
    found = np.empty((len(draws_um), len(rows)))
    for draw_um, errors in zip(draws_um, found, strict=True):
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            errors[part] = cv2.remap(
                draw_um, right[:, part], down[:, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )[0]
    return found
