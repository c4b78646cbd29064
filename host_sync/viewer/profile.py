"""Heights along a line, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, Float64Array
from host_sync.errors import ViewError
from host_sync.profile.profile_line import Line, Profile, bilinear

MAX_POINTS: Final = 20_000
WHOLE_PX: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLine(Profile):
    """A profile from end to end of a line, in steps of at most one pixel.

    rows, columns : float64 arrays of shape (N,), places of the samples, px
    sigma_um : float64 array of shape (N,), standard uncertainty of each height above untouched skin; None if unknown
    samples_um : float64 array of shape (K, N), Monte Carlo samples of the error along the line; None if there are none
    """

    rows: Float64Array
    columns: Float64Array
    sigma_um: Float64Array | None
    samples_um: Float64Array | None

    def difference_sigma_um(self, first: int, last: int) -> float | None:
        """Standard uncertainty of z[last] - z[first]: smaller than that of either, as most of their error is common."""
        if self.samples_um is None:
            return None
        return float(np.sqrt(np.mean((self.samples_um[:, last] - self.samples_um[:, first]) ** 2)))


def measure_line(
    z_um: Float32Array,
    pitch_um: float,
    line: Line,
    samples_um: Float32Array | None = None,
    sigma_um: Float32Array | None = None,
) -> MeasuredLine:
    """The profile along a line; along a row or a column it is the array itself.

    samples_um : float32 array of shape (K, h, w), samples of the height error on a reduced grid
    sigma_um : float32 array of shape (H, W), used where there are no samples

    Raises
    ------
    ViewError
        The line has no length, or leaves the height map.
    """
    shape = (z_um.shape[0], z_um.shape[1])
    rows, columns = _places(line, pitch_um, shape)
    places = np.stack([columns, rows], axis=-1)
    errors = None if samples_um is None else _drawn(samples_um, rows, columns, shape)
    if errors is not None:
        known = np.sqrt(np.mean(errors**2, axis=0))
    else:
        known = None if sigma_um is None else bilinear(sigma_um, places)[0]
    return MeasuredLine(
        z_um=bilinear(z_um, places)[0],
        step_um=line.length_um / (len(rows) - 1),
        rows=rows,
        columns=columns,
        sigma_um=known,
        samples_um=errors,
    )


def _places(line: Line, pitch_um: float, shape: tuple[int, int]) -> tuple[Float64Array, Float64Array]:
    """Rows and columns of the samples, px."""
    ends = np.array([line.start_um, line.end_um]).T[::-1] / pitch_um
    whole = np.round(ends)
    ends = np.where(np.abs(ends - whole) < WHOLE_PX, whole, ends)
    if not np.isfinite(ends).all() or (ends < 0).any() or (ends.max(axis=1) > np.array(shape) - 1).any():
        raise ViewError("the profile leaves the height map: draw it inside")
    length_px = float(np.hypot(*(ends[:, 1] - ends[:, 0])))
    if not length_px > 0:
        raise ViewError("the profile has no length: draw it from one place to another")
    count = min(int(np.ceil(length_px - WHOLE_PX)) + 1, MAX_POINTS)
    rows, columns = (np.linspace(first, last, max(count, 2)) for first, last in ends)
    return rows, columns


def _drawn(samples_um: Float32Array, rows: Float64Array, columns: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """The samples along the line: their cells cover several pixels each."""
    factor_rows, factor_columns = shape[0] / samples_um.shape[1], shape[1] / samples_um.shape[2]
    down = ((rows + 0.5) / factor_rows - 0.5).astype(np.float32)[None]
    right = ((columns + 0.5) / factor_columns - 0.5).astype(np.float32)[None]
    step = 4096  # cv2.remap takes at most 32767 places per line
    found = np.empty((len(samples_um), len(rows)))
    for sample_um, errors in zip(samples_um, found, strict=True):
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            errors[part] = cv2.remap(
                sample_um, right[:, part], down[:, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )[0]
    return found
