"""Slopes of cells of a frame by the forward model: Gauss-Newton steps with a prior, between them heights.

Elevation, visibility and light from other skin follow from the height map of the cells, and that from their slopes:
both are found in turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np

from device.inverse_map.skin_at_rest import RESTING
from device.surface import Float32Array, Float64Array, GradientField, HeightMap, MaskArray, surface_slopes
from host_sync.integration.integrate import Integrator
from host_sync.integration.zero_level import find_datum
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.light.kernels import SCAN_CELLS, incoming_light, write_search
from host_sync.light.model import ELEVATION, MONOMIALS, POINT_WEIGHTS, LightModel
from host_sync.uncertainty.elevation import ElevationCorrection

FIRST_STEPS: Final = 3
STEPS: Final = (2, 2, 2)
"""Steps from level heights, and in each round after the heights were found."""

MAX_MOVE: Final = 0.3
"""Slope by which one step moves at most."""

HIDDEN_SIGMA: Final = 0.3
"""Standard uncertainty of light that other skin hides, as a fraction of it: heights on the ray are not sure."""

UNEVEN_ERROR: Final = 0.3
"""Standard uncertainty of what slopes that differ within a cell change, as a fraction of it: a blur hides a part."""

OUTLYING: Final = 4.0
"""Standard deviations at which an error of the intensity counts half."""

SHADOW_ERROR: Final = 0.3
"""Standard uncertainty of slopes that the inverse map reads in shadow, where the model predicts shadow rightly."""

MAP_REACH: Final = 0.8
"""Slope, relative to the steepest of the balls, from which the inverse map's slopes stay behind those of the skin: from
there to the steepest their standard uncertainty grows to the slope itself."""

AT_REST: Final = 0.01
"""Fraction of its slope that a cell at rest keeps, at most."""

REST_INFORMATION: Final = 100.0
"""Weight of a slope of skin at rest in the integration, relative to that of others."""

IN_SHADOW: Final = 0.3
"""Hidden fraction of a channel's light from which a cell lies wholly in shadow; below it, in proportion."""

SHADOW_WEIGHT: Final = 0.3
"""Weight of slopes in shadow relative to that of others, in the heights between steps and in the final integration."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of a frame, in row-major order.

    model : of the sensor's light
    size : (h, w)
    cell : pixels along a cell
    column, row : of their middles, pixels, float64 arrays of shape (N,)
    intensity : float64 array of shape (N, C), finite
    faithful : bool array of shape (N,), True where the intensity of a cell is known
    start : slopes by the inverse map, float64 array of shape (N, 2)
    bend : what the mean light of a cell hides of its slope (`slopes_hidden_by_means`), shape (N, 2)
    prior_sigma : standard uncertainty of `start` at the elevations that balls showed
    believed : fraction of what elevation changes by the model that `start` is corrected for
    elevation : those elevations, and what others change; None where they do not matter
    kept : fraction of its slope that a cell keeps where light shows skin at rest, shape (h, w), see `RestEvidence`;
        None where it shows none
    zero_sigma_px : standard uncertainty of the elevation of the whole field
    uneven : correction of `intensity` for slopes that differ within a cell, shape (N, C); None for nothing
    arriving : fraction of each channel's light that arrives as frames of single lights show, shape (N, C); None
        without such frames
    """

    model: LightModel
    size: tuple[int, int]
    cell: int
    column: Float64Array
    row: Float64Array
    intensity: Float64Array
    faithful: MaskArray
    start: Float64Array
    bend: Float64Array
    prior_sigma: float
    believed: float = 0.0
    elevation: ElevationCorrection | None = None
    kept: Float32Array | None = None
    zero_sigma_px: float = 0.0
    uneven: Float64Array | None = None
    arriving: Float64Array | None = None

    @cached_property
    def active(self) -> np.ndarray:
        """Numbers of the cells that light does not show at rest: of the others, `start` stays."""
        if self.kept is None:
            return np.arange(len(self.column))
        return np.flatnonzero(self.kept > AT_REST)

    @cached_property
    def rest(self) -> Float64Array:
        """Light of skin at rest, shape (N, C)."""
        return self.model.mixed(self.rest_light)

    @cached_property
    def residual(self) -> Float64Array:
        """Coefficients of the residual field, shape (N, C, terms)."""
        return np.ascontiguousarray(self.model.residual_at(*self.places(np.zeros(self.size, np.float32))[:2]))

    @cached_property
    def rest_light(self) -> Float64Array:
        """Light of every source on skin at rest, shape (N, S)."""
        level = np.zeros_like(self.column)
        x, y, _ = self.places(np.zeros(self.size, np.float32))
        return self.model.light(level, level, x, y, level)

    def solve(self) -> CellSlopes:
        """Return the slopes of the largest posterior; without sources, heights change no light."""
        found = self._search(CellSlopes.level(self), FIRST_STEPS)
        if not len(self.model.sources):
            return self._search(found, STEPS[0])
        solver = Integrator(self.size)
        for steps in STEPS:
            found = self._search(self._with_heights(found, solver), steps)
        return found

    def solve_raised(self, found: CellSlopes, elevation_px: float, steps: int) -> CellSlopes:
        """Return slopes from others, over heights whose median is a given elevation."""
        return self._search(self._with_heights(found, Integrator(self.size), elevation_px), steps)

    def solve_at(self, found: CellSlopes, z_px: Float32Array, steps: int) -> CellSlopes:
        """Return slopes of unshaded skin at given elevations, shape (h, w)."""
        return self._search(replace(found, z_px=z_px), steps)

    def confirmed_change(self, found: CellSlopes, confirmed: float) -> Float64Array:
        """Return what `start` gains, shape (N, 2): all that sources predict, of the rest the confirmed fraction.

        Sources predict what elevation and light from other skin change, and that the inverse map is wrong in shadow.
        """
        certain = (1.0 - confirmed) * (1.0 - found.shadow[:, None])
        expected = self.start - self.believed * found.misread
        slope = found.slope - certain * (found.slope - expected)
        return np.where(self.faithful[:, None], slope - self.start, 0.0)

    def _search(self, found: CellSlopes, steps: int) -> CellSlopes:
        """Move slopes by Gauss-Newton steps; heights, visibility and incoming light stay."""
        model = self.model
        x, y, z = self.places(found.z_px)
        slope, rest = found.slope.copy(), self.rest
        change, weight = np.zeros((*self.intensity.shape, 2)), np.zeros_like(self.intensity)
        counted = np.where(self.faithful[:, None], self.intensity, np.nan_to_num(found.shown, nan=1.0))
        hidden = found.shadow[:, None]
        start = self.start - self.believed * found.misread
        expected = (1.0 - hidden) * start + hidden * found.surface
        known = self.prior_weight(found)
        exponents = np.array(MONOMIALS, np.intp)
        sources = (*model.geometry, model.coat, model.strengths, model.haze, exponents)
        incoming = np.ascontiguousarray(model.albedo * found.incoming)
        skin = (x, y, z, rest, found.visible, incoming, self.residual)
        by_zero = self.residual[..., -1] * (self.zero_sigma_px / model.shape[1] / ELEVATION)
        variance = model.variance(found.slope) + np.square(by_zero)
        if self.uneven is not None:
            variance += np.square(UNEVEN_ERROR * self.uneven)
        limits = (MAX_MOVE, HIDDEN_SIGMA, OUTLYING, ELEVATION)
        work = len(self.active), 15 * steps * len(model.sources)
        parallel_rows(
            write_search, work, sources, skin, (counted, variance), (expected, known), limits, steps, self.active,
            slope, change, weight,
        )  # fmt: skip
        return replace(found, slope=slope, change=change, weight=np.where(self.faithful[:, None], weight, 0.0))

    def prior_weight(self, found: CellSlopes) -> Float64Array:
        """Return one over the variance of `start`, which the inverse map read at other elevations, shape (N,)."""
        doubt = 1.0 - self.believed
        square = np.square(found.slope).sum(axis=1)
        variance = self.prior_sigma**2 + doubt**2 * np.square(found.unseen).sum(axis=1)
        variance += np.square(SHADOW_ERROR * self.believed * found.shadow)
        if len(self.model.sources):
            beyond = np.maximum(np.sqrt(square) - MAP_REACH * self.model.steepest, 0.0)
            variance += np.square(beyond / (1.0 - MAP_REACH))
        if self.elevation is not None:
            gain = self.elevation.steeper(found.z_px.ravel(), square.astype(np.float32)).astype(np.float64)
            variance += square * (doubt * gain) ** 2
        return np.asarray(1.0 / variance)

    def _misread(self, found: CellSlopes) -> tuple[Float64Array, Float64Array]:
        """Return by how much `start` is off at other elevations than 0 and under other light around than balls have.

        Two arrays of shape (N, 2): as the model predicts it, and what of it the balls did not show.
        """
        model, here = self.model, self.active
        square = np.square(found.slope[here]).sum(axis=1)
        shown = np.zeros(len(here))
        if self.elevation is not None:
            shown = self.elevation.trained_px(square.astype(np.float32)) / model.shape[1]
        x, y, z = (part[here] for part in self.places(found.z_px))
        p, q = found.slope[here].T
        rest, change = self.rest[here], found.change[here]
        weighted = change * found.weight[here][..., None]
        system = np.swapaxes(weighted, 1, 2) @ change + np.eye(2) / self.prior_sigma**2
        around = model.albedo * (found.incoming[here] - _light_of_floor(square)[:, None])
        light = model.light(p, q, x, y, z) * found.visible[here]
        slopes = np.zeros((2, *found.slope.shape))
        for number, below in enumerate((np.zeros_like(x), shown)):
            less = (light - model.light(p, q, x, y, below)) @ model.strengths.T / rest + around
            gradient = np.einsum("ncj,nc->nj", weighted, less)
            slopes[number, here] = np.linalg.solve(system, gradient[..., None])[..., 0]
        return slopes[0], slopes[1]

    def _with_heights(self, found: CellSlopes, solver: Integrator, elevation_px: float | None = None) -> CellSlopes:
        """Return heights of the slopes, and what arrives of the light over them.

        elevation_px : median of the heights; None where level skin has the elevation 0
        """
        model, size = self.model, self.size
        mean = (found.slope + self.bend).reshape(*size, 2)
        p, q = (np.ascontiguousarray(mean[..., axis], np.float32) for axis in (0, 1))
        certain = 1.0 - (1.0 - SHADOW_WEIGHT) * found.shadow
        weight = np.where(self.faithful, certain, 0.1).reshape(size).astype(np.float32)
        if self.kept is not None:
            p, q = self.kept * p, self.kept * q
            weight *= np.float32(1.0) + np.float32(REST_INFORMATION) * (np.float32(1.0) - self.kept) ** 4
        field = GradientField(p, q, np.ones(size, np.bool_), weight)
        height = solver.integrate(field, float(self.cell))[0]
        height = HeightMap(height.z_um.copy(), float(self.cell))
        z_px = np.asarray(height.z_um + np.float32(self._shift_px(height, field, elevation_px)), np.float32)
        surface = np.stack(surface_slopes(height), axis=-1).astype(np.float64).reshape(-1, 2) - self.bend
        active = np.zeros(size, np.bool_)
        active.flat[self.active] = True
        visible = visible_fraction(z_px, self.cell, model, active).reshape(len(found.slope), -1)
        if self.arriving is not None:
            visible = np.minimum(visible, self.arriving[:, model.strengths.argmax(axis=0)])
        shown = (self.intensity * self.rest).reshape(*size, -1)
        incoming = incoming_light(shown, p, q, z_px / np.float32(self.cell), SCAN_CELLS).reshape(self.rest.shape)
        dark = ((self.rest_light * (1.0 - visible)) @ model.strengths.T / self.rest).max(axis=1)
        found = replace(
            found, z_px=z_px, surface=surface, visible=np.ascontiguousarray(visible), incoming=incoming / self.rest,
            shadow=np.where(active.ravel(), np.clip(dark / IN_SHADOW, 0.0, 1.0), 0.0),
        )  # fmt: skip
        misread, unseen = self._misread(found)
        return replace(found, misread=misread, unseen=unseen)

    def _shift_px(self, height: HeightMap, field: GradientField, elevation_px: float | None) -> float:
        """Return what heights gain for skin at rest, or for their median, to have a given elevation."""
        if elevation_px is not None:
            return elevation_px - float(np.median(height.z_um))
        if self.kept is not None:
            return -float(np.median(height.z_um[self.kept <= max(RESTING, float(self.kept.min()))]))
        return -find_datum(height, field).zero_um

    def places(self, z_px: Float32Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return the places of the cells at elevations (h, w)."""
        return self.model.places(self.column, self.row, z_px.ravel().astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class CellSlopes:
    """Slopes of cells, and what they were found with.

    slope : float64 array of shape (N, 2)
    change, weight : derivatives of the intensity, shape (N, C, 2), and weights of the channels, shape (N, C)
    surface : slopes of the surface that all slopes together make, shape (N, 2)
    visible, incoming : see `visible_fraction` (N, S), and `incoming_light` over the light at rest (N, C)
    shadow : how much of a cell's light is hidden, 0 to 1, shape (N,)
    shown : intensity in place of that of cells which are not known, shape (N, C)
    z_px : elevation, float32 array of shape (h, w)
    misread, unseen : by how much `start` is off at other elevations than 0 and under other light around than balls
        have, and what of it the balls did not show, shape (N, 2)
    """

    slope: Float64Array
    change: Float64Array
    weight: Float64Array
    surface: Float64Array
    visible: Float64Array
    incoming: Float64Array
    shadow: Float64Array
    shown: Float64Array
    z_px: Float32Array
    misread: Float64Array
    unseen: Float64Array

    @classmethod
    def level(cls, cells: Cells) -> CellSlopes:
        """Return what is known before the search: the inverse map's slopes of unshaded skin over a level floor."""
        count, channels = cells.intensity.shape
        floor = np.repeat(_light_of_floor((cells.start**2).sum(axis=1))[:, None], channels, axis=1)
        return cls(
            cells.start.copy(), np.zeros((count, channels, 2)), np.zeros((count, channels)), cells.start,
            np.ones((count, len(cells.model.sources))), floor, np.zeros(count), np.ones((count, channels)),
            np.zeros(cells.size, np.float32), np.zeros_like(cells.start), np.zeros_like(cells.start),
        )  # fmt: skip


def _light_of_floor(square: Float64Array) -> Float64Array:
    """Return the light from level skin around that reaches skin of slopes with this p² + q², over the light at rest."""
    return np.asarray(0.5 * (1.0 - 1.0 / np.sqrt(1.0 + square)))


# Fraction of each source's light that reaches the cells of a surface: rays to the points of its strip.
#
# The height of skin on a ray is not sure, so that a ray that grazes it is partly open. What a cell's own plane hides
# follows from the cosine law and hides nothing here: a slope that is estimated too steep would hide the light that
# corrects it.

HALF_SHADOW: Final = 0.05
"""Tangent by which a ray clears cells where all of its light arrives, and by which it fails to where none does: sources
are not points, and cells round edges off."""

OVER_OWN_PLANE: Final = 0.05
"""Tangent by which skin on the way stands over a cell's own plane where it hides as much of a source as rays show."""

STRIDE: Final = 4
"""Cells that a ray passes at once where no skin around comes near it."""

WORK: Final = 200
"""Pixels of a field whose kernels take as long as the rays of one cell."""


def visible_fraction(z_px: Float32Array, cell: int, model: LightModel, active: MaskArray | None = None) -> Float64Array:
    """Return how much of each source's light arrives, 0 to 1: float64 array of shape (h, w, S).

    z_px : elevation of cells of `cell` x `cell` pixels of the model's field, shape (h, w), at least (2, 2); finite
    active : bool array of shape (h, w), cells that rays are followed from; all light arrives at the others
    """
    p, q = surface_slopes(HeightMap(z_px, float(cell)))
    points = model.geometry[0][..., :3] * model.shape[1]
    visible = np.ones((*z_px.shape, len(points)))
    active = np.ones(z_px.shape, np.bool_) if active is None else active
    grid = float(cell), 0.5 * (cell - model.shape[1]), 0.5 * (cell - model.shape[0])
    around = cv2.dilate(z_px, np.ones((2 * STRIDE + 3, 2 * STRIDE + 3), np.uint8))
    work = z_px.shape[0], WORK * z_px.shape[1]
    parallel_rows(_write_visible, work, z_px, p, q, around, points, POINT_WEIGHTS, grid, active, visible)
    return visible


@njit(cache=True, nogil=True, error_model="numpy")
def _write_visible(
    z: Any, p: Any, q: Any, around: Any, points: Any, weights: Any, grid: Any, active: Any, visible: Any, first: int,
    last: int,
) -> None:  # fmt: skip
    """Write what arrives of sources into the rows `first` to `last` - 1 of `visible`, (h, w, S).

    around : the highest of cells up to `STRIDE` + 1 rows and columns away, shape (h, w)
    points : of each source, pixels from the middle of the field, shape (S, points, 3)
    grid : pixels along a cell; column and row of the middle of the first one from the middle of the field
    """
    cell, left, upper = grid
    rows, columns = z.shape
    top = float(around.max())
    for i in range(first, last):
        for j in range(columns):
            if not active[i, j]:
                continue
            own_z, x, y = z[i, j], left + j * cell, upper + i * cell
            for source in range(points.shape[0]):
                visible[i, j, source] = 0.0
                for point in range(points.shape[1]):
                    across, down = points[source, point, 0] - x, points[source, point, 1] - y
                    distance = max(np.sqrt(across * across + down * down), 1e-3)
                    across, down = across / distance, down / distance
                    rise = max(points[source, point, 2] - own_z, 1.0) / distance
                    clear, step = HALF_SHADOW, 1
                    # Farther on even the highest skin comes near no ray.
                    while step * cell < distance and rise - (top - own_z) / (step * cell) < clear:
                        column, row = j + step * across, i + step * down
                        if not (0.0 <= column <= columns - 1 and 0.0 <= row <= rows - 1):
                            break
                        c, r = min(int(column), columns - 2), min(int(row), rows - 2)
                        if max(around[r, c] - own_z, 0.0) <= (rise - clear) * step * cell:
                            step += STRIDE
                            continue
                        u, v = column - c, row - r
                        met = (1.0 - v) * ((1.0 - u) * z[r, c] + u * z[r, c + 1])
                        met += v * ((1.0 - u) * z[r + 1, c] + u * z[r + 1, c + 1])
                        clear = min(clear, rise - (met - own_z) / (step * cell))
                        step += 1
                    passes = min(max((clear + HALF_SHADOW) / (2.0 * HALF_SHADOW), 0.0), 1.0)
                    own = rise - (p[i, j] * across + q[i, j] * down)
                    in_the_way = min(max((own - clear) / OVER_OWN_PLANE, 0.0), 1.0)
                    visible[i, j, source] += weights[point] * (1.0 - (1.0 - passes) * in_the_way)
