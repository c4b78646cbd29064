"""Levelling of a height map before anything is measured, on what a person chose, and what it does to the ±.

A level is a plane that least squares puts through the chosen pixels. Each Monte Carlo sample is levelled as the height
map is, so that every ± contains what levelling takes from the error and what it adds to it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array, GradientField, HeightMap, MaskArray, surface_slopes
from host_sync.errors import MeasurementError
from host_sync.integration.zero_level import find_datum
from host_sync.measurement.geometry import Region
from host_sync.measurement.recipe import LevelTable
from host_sync.profile.profile_line import Line, bilinear
from host_sync.results.reader import ResultSurface

POINT_REACH_PX: Final = 1.5
"""Pixels up to here from a chosen point give its height."""

MAX_FITTED: Final = 200_000
"""Most pixels that the plane is fitted to."""

SPREAD_PX: Final = 128
"""Rows and columns of pixels, at most, at which the spread of the samples is looked at."""


class Levelling:
    """The level of a recipe for the height maps of one result.

    Parameters
    ----------
    table : what to level on
    surface : the result

    Raises
    ------
    MeasurementError
        The chosen places lie outside the field, on masked pixels, or do not determine a level.
    """

    def __init__(self, table: LevelTable, surface: ResultSurface) -> None:
        height = surface.height
        self._shape = height.z_um.shape
        rows, columns = self._shape
        self._row, self._column = np.arange(rows) - 0.5 * (rows - 1), np.arange(columns) - 0.5 * (columns - 1)
        if table.on == "line":
            start, end = table.points_um
            self.words = "levelled on a line"
            self._plane: Callable[[Float32Array], Float64Array] = self._along(Line(start, end), height)
            return
        used = _chosen(table, surface)
        self.words = {
            "skin": f"levelled on untouched skin, {used.mean():.0%} of the field",
            "points": f"levelled on {len(table.points_um)} points",
            "plane": f"levelled on the plane through {used.mean():.0%} of the field",
        }[table.on]
        self._plane = self._through(used)

    def plane(self, z_um: Float32Array) -> tuple[float, float, float]:
        """Return the level of a height map: µm at the middle of the field, and per pixel down and across."""
        zero, down, across = (float(value) for value in self._plane(z_um))
        return zero, down, across

    def apply(self, z_um: Float32Array) -> Float32Array:
        """Return a height map of shape (H, W) less its level, float32."""
        zero, down, across = self.plane(z_um)
        plane = zero + down * self._row[:, None] + across * self._column
        return np.asarray(z_um - plane.astype(np.float32), np.float32)

    def _through(self, used: MaskArray) -> Callable[[Float32Array], Float64Array]:
        """Return the function that fits a plane to the heights of the used pixels.

        It returns the height at the middle of the field and the slopes per row and column, µm/px.
        """
        row, column = np.nonzero(used)
        step = max(1, row.size // MAX_FITTED)
        row, column = row[::step], column[::step]
        design = np.stack([np.ones(row.size), self._row[row], self._column[column]], axis=-1)
        if row.size < 3 or np.linalg.matrix_rank(design, tol=1e-6 * max(self._shape)) < 3:
            raise MeasurementError("level: the chosen places do not determine a plane: choose some apart from others")
        inverse = np.linalg.pinv(design)
        return lambda z_um: np.asarray(inverse @ z_um[row, column].astype(np.float64), np.float64)

    def _along(self, line: Line, height: HeightMap) -> Callable[[Float32Array], Float64Array]:
        """Return what `_through` does, with no slope across the line."""
        start, end = (np.array(place) / height.pitch_um for place in (line.start_um, line.end_um))
        length = float(np.hypot(*(end - start)))
        count = int(length) + 1
        if count < 3:
            raise MeasurementError("level: the line is shorter than three pixels: move its ends apart")
        places = np.linspace(start, end, count)
        _, seen = bilinear(height.z_um, places)
        if seen.sum() < 3:
            raise MeasurementError("level: the line holds fewer than three valid pixels: draw it elsewhere")
        places = places[seen]
        way = (end - start) / length
        middle = np.array([0.5 * (self._shape[1] - 1), 0.5 * (self._shape[0] - 1)])
        along = (places - middle) @ way
        inverse = np.linalg.pinv(np.stack([np.ones(along.size), along], axis=-1))
        turn = np.array([[1.0, 0.0], [0.0, way[1]], [0.0, way[0]]])
        return lambda z_um: np.asarray(turn @ (inverse @ bilinear(z_um, places)[0]), np.float64)


class LevelSpread:
    """Spread of heights over the samples at a few pixels, before and after levelling.

    Parameters
    ----------
    nominal_um : float32 array of shape (H, W), the levelled height map
    """

    def __init__(self, nominal_um: Float32Array) -> None:
        step = max(1, max(nominal_um.shape) // SPREAD_PX)
        self._here = (slice(None, None, step), slice(None, None, step))
        self._nominal_um = nominal_um[self._here].astype(np.float64)
        self._squares = np.zeros((2, *self._nominal_um.shape))

    def add(self, before_um: Float32Array, after_um: Float32Array) -> None:
        """Take one sample in."""
        for square, z_um in zip(self._squares, (before_um, after_um), strict=True):
            square += (z_um[self._here] - self._nominal_um) ** 2

    def words(self, samples: int) -> str:
        """Return what levelling does to the ± of heights; nothing without samples."""
        known = np.isfinite(self._squares[0])
        if not samples or not known.any():
            return ""
        before, after = (float(np.median(np.sqrt(square[known] / samples))) for square in self._squares)
        return f": the median ± of a height changes from {before:.2g} to {after:.2g} µm (k = 1)"


def _chosen(table: LevelTable, surface: ResultSurface) -> MaskArray:
    """Return the pixels that the level is fitted to: bool array of shape (H, W)."""
    height = surface.height
    valid = np.isfinite(height.z_um)
    used = np.zeros(valid.shape, np.bool_)
    if table.regions_um:
        for region in table.regions_um:
            used[Region(*region).pixels((valid.shape[0], valid.shape[1]), height.pitch_um)] = True
    elif table.on == "skin":
        used = untouched_skin(surface)
    for column_um, row_um in table.points_um if table.on == "points" else ():
        row, column = (np.arange(size)[:, None] for size in valid.shape)
        near = np.hypot(row - row_um / height.pitch_um, column.T - column_um / height.pitch_um) <= POINT_REACH_PX
        if not (near & valid).any():
            raise MeasurementError(f"level: the point ({column_um:g}, {row_um:g}) µm is masked or outside: move it")
        used |= near
    if not (used & valid).any():
        raise MeasurementError("level: every chosen pixel is masked: choose other places")
    return np.asarray(used & valid)


def untouched_skin(surface: ResultSurface) -> MaskArray:
    """Return the untouched skin of a surface, bool array of shape (H, W).

    It is the mask that reconstruction wrote, else what is flat, low and far from all else.

    Raises
    ------
    MeasurementError
        No skin is untouched.
    """
    if surface.untouched is not None and surface.untouched.any():
        return surface.untouched
    height = surface.height
    if min(height.z_um.shape) < 2:
        raise MeasurementError("level: a single row or column of pixels shows no untouched skin")
    p, q = surface_slopes(height)
    valid = np.isfinite(p) & np.isfinite(q)
    p, q = (np.nan_to_num(part).astype(np.float32) for part in (p, q))
    datum = find_datum(height, GradientField(p, q, valid, valid.astype(np.float32)), are_its_own=True)
    if datum.is_relative:
        raise MeasurementError('level: no skin is untouched: draw regions_um, or level on "points", "line" or "plane"')
    return datum.skin
