"""Slopes of cells of a frame by the forward model: Gauss-Newton steps with a prior, between them heights.

Elevation, visibility and light from other skin follow from the height map of the cells, and that from their slopes:
both are found in turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.surface.fields import Float32Array, Float64Array, GradientField, HeightMap, MaskArray, surface_slopes
from host_sync.integration.integrate import Integrator
from host_sync.integration.zero_level import find_datum
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.light.interreflection import incoming_light
from host_sync.light.kernels import write_search
from host_sync.light.model import ELEVATION, MONOMIALS, LightModel
from host_sync.light.visibility import visible_fraction
from host_sync.uncertainty.elevation import ElevationCorrection

FIRST_STEPS: Final = 5
STEPS: Final = (3, 2, 2, 2)
"""Steps from level heights, and in each round after the heights were found."""

STEP: Final = 1e-3
MAX_MOVE: Final = 0.3
"""Slope by which derivatives are taken, and by which one step moves at most."""

HIDDEN_SIGMA: Final = 0.3
"""Standard uncertainty of light that other skin hides, as a fraction of it: heights on the ray are not sure."""

OUTLYING: Final = 4.0
"""Standard deviations at which an error of the intensity counts half."""

IN_SHADOW: Final = 0.3
"""Hidden fraction of a channel's light from which a cell lies in shadow."""

SHADOW_WEIGHT: Final = 0.3
"""Weight of slopes in shadow in the integration, relative to that of others."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Cells of a frame, in row-major order.

    model : of the sensor's light
    size : (h, w)
    cell : pixels along a cell
    column, row : of their middles, pixels, float64 arrays of shape (N,)
    intensity : float64 array of shape (N, C), finite
    faithful : bool array of shape (N,), True where the intensity of a cell is known
    start : slopes by the inverse map, float64 array of shape (N, 2)
    bend : what the mean light of a cell hides of its slope (`bent_cells`), shape (N, 2)
    prior_sigma : standard uncertainty of `start` at the elevations that balls showed
    elevation : those elevations, and what others change; None where they do not matter
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
    elevation: ElevationCorrection | None = None
    arriving: Float64Array | None = None

    def solve(self) -> CellSlopes:
        """Return the slopes of the largest posterior."""
        solver = Integrator(self.size)
        found = self._search(CellSlopes.level(self), FIRST_STEPS)
        for steps in STEPS:
            found = self._search(self._with_heights(found, solver), steps)
        return found

    def solve_raised(self, found: CellSlopes, elevation_px: float, steps: int) -> CellSlopes:
        """Return slopes from others, over heights whose median is a given elevation."""
        return self._search(self._with_heights(found, Integrator(self.size), elevation_px), steps)

    def solve_at(self, found: CellSlopes, z_px: Float32Array, steps: int) -> CellSlopes:
        """Return slopes at given elevations, shape (h, w)."""
        return self._search(replace(found, z_px=z_px), steps)

    def _search(self, found: CellSlopes, steps: int) -> CellSlopes:
        """Move slopes by Gauss-Newton steps; heights, visibility and incoming light stay."""
        model = self.model
        x, y, z = self.places(found.z_px)
        slope, rest = found.slope.copy(), model.rest(x, y)
        change, weight = np.empty((*self.intensity.shape, 2)), np.empty_like(self.intensity)
        counted = np.where(self.faithful[:, None], self.intensity, np.nan_to_num(found.shown, nan=1.0))
        hidden = found.shadow[:, None]
        expected = (1.0 - hidden) * self.start + hidden * found.surface
        known = self.prior_weight(found)
        exponents = np.array(MONOMIALS, np.intp)
        sources = (*model.geometry, model.coat, model.strengths, model.haze, exponents)
        incoming = np.ascontiguousarray(model.albedo * found.incoming)
        skin = (x, y, z, rest, found.visible, incoming, np.ascontiguousarray(model.residual_at(x, y)))
        limits = (STEP, MAX_MOVE, HIDDEN_SIGMA, OUTLYING, ELEVATION)
        work = len(slope), 40 * steps * len(model.sources)
        parallel_rows(
            write_search, work, sources, skin, (counted, model.variance(found.slope)), (expected, known), limits, steps,
            slope, change, weight,
        )  # fmt: skip
        return replace(found, slope=slope, change=change, weight=np.where(self.faithful[:, None], weight, 0.0))

    def prior_weight(self, found: CellSlopes) -> Float64Array:
        """Return one over the variance of `start`, which the inverse map read at other elevations, shape (N,)."""
        square = np.square(found.slope).sum(axis=1)
        if self.elevation is None:
            return np.full(len(square), self.prior_sigma**-2)
        gain = self.elevation.steeper(found.z_px.ravel(), square.astype(np.float32)).astype(np.float64)
        return np.asarray(1.0 / (self.prior_sigma**2 + square * gain**2))

    def _with_heights(self, found: CellSlopes, solver: Integrator, elevation_px: float | None = None) -> CellSlopes:
        """Return heights of the slopes, and what arrives of the light over them.

        elevation_px : median of the heights; None where level skin has the elevation 0
        """
        model, size = self.model, self.size
        mean = (found.slope + self.bend).reshape(*size, 2)
        p, q = (np.ascontiguousarray(mean[..., axis], np.float32) for axis in (0, 1))
        weight = (1.0 - (1.0 - SHADOW_WEIGHT) * found.shadow) * np.where(self.faithful, 1.0, 0.1)
        everywhere = np.ones(size, np.bool_)
        field = GradientField(p, q, everywhere, weight.reshape(size).astype(np.float32))
        height = solver.integrate(field, float(self.cell))[0]
        height = HeightMap(height.z_um.copy(), float(self.cell))
        if elevation_px is None:
            z_px = np.asarray(np.nan_to_num(find_datum(height, field).level(height).z_um), np.float32)
        else:
            z_px = np.asarray(height.z_um + np.float32(elevation_px - np.median(height.z_um)), np.float32)
        surface = np.stack(surface_slopes(height), axis=-1).astype(np.float64).reshape(-1, 2) - self.bend
        visible = visible_fraction(z_px, self.cell, model).reshape(len(found.slope), -1)
        if self.arriving is not None:
            visible = np.minimum(visible, self.arriving[:, model.strengths.argmax(axis=0)])
        x, y, _ = self.places(z_px)
        rest = model.rest(x, y)
        shown = (self.intensity * rest).reshape(*size, -1)
        incoming = incoming_light(shown, p, q, z_px / np.float32(self.cell)).reshape(rest.shape) / rest
        p_cell, q_cell = found.slope.T
        light = model.light(p_cell, q_cell, x, y, z_px.ravel() / model.shape[1])
        dark = ((light * (1.0 - visible)) @ model.strengths.T / rest).max(axis=1)
        shadow = np.clip(dark / IN_SHADOW, 0.0, 1.0)
        return replace(
            found, z_px=z_px, surface=surface, visible=np.ascontiguousarray(visible), incoming=incoming,
            shadow=shadow,
        )  # fmt: skip

    def places(self, z_px: Float32Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return the places of the cells at elevations (h, w)."""
        return self.model.places(self.column, self.row, z_px.ravel().astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class CellSlopes:
    """Slopes of cells, and what they were found with.

    slope : float64 array of shape (N, 2)
    change, weight : derivatives of the intensity, shape (N, C, 2), and weights of the channels, shape (N, C)
    surface : slopes of the surface that all slopes together make, shape (N, 2)
    visible, incoming : as of `visible_fraction` (N, S), and `incoming_light` over the light at rest (N, C)
    shadow : how much of a cell's light is hidden, 0 to 1, shape (N,)
    shown : intensity that stands for that of cells which are not known, shape (N, C)
    z_px : elevation, float32 array of shape (h, w)
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

    @classmethod
    def level(cls, cells: Cells) -> CellSlopes:
        """Return what is known before the search: the inverse map's slopes of unshaded skin over a level floor."""
        count, channels = cells.intensity.shape
        tilted = 1.0 - 1.0 / np.sqrt(1.0 + (cells.start**2).sum(axis=1))
        floor = np.repeat(0.5 * tilted[:, None], channels, axis=1)
        return cls(
            cells.start.copy(), np.zeros((count, channels, 2)), np.zeros((count, channels)), cells.start,
            np.ones((count, len(cells.model.sources))), floor, np.zeros(count), np.ones((count, channels)),
            np.zeros(cells.size, np.float32),
        )  # fmt: skip
