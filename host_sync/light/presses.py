"""Light from skin to skin in calibration presses, and the held-out reading of their balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.balls.sphere import Ball, gather_samples, pixels_inside, sphere_slopes
from device.calibration.fit import CORE_SHARE
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import Float32Array, Float64Array, GradientField, HeightMap
from host_sync.gradients.inverse_map_kernel import evaluate
from host_sync.integration.datum import cell_means
from host_sync.integration.integrate import integrate
from host_sync.integration.zero_level import find_datum
from host_sync.kernels.cell_rows import cell_px, means_of_cells, middles_of_cells
from host_sync.light.cells import MAP_REACH, Cells, CellSlopes
from host_sync.light.fit import FittedLight, fit_light
from host_sync.light.interreflection import incoming_light
from host_sync.light.model import LightModel
from host_sync.uncertainty.elevation import ElevationCorrection
from host_sync.uncertainty.slope_error import OverCells

READER_STEPS: Final = 5

STACKED: Final = 400
"""Pixels of a ball that the fraction of the changes is found with."""

MIN_CONFIRMED: Final = 0.05
"""Fraction of the changes from which they are worth their time."""

Press = tuple[NormalizedImage, Sequence[Ball]]


def fit_light_of_presses(
    presses: Sequence[Press],
    inverse: InverseMap,
    apexes_px: Sequence[float],
    positions: Float64Array | None = None,
) -> FittedLight:
    """Return the light model that the balls of presses show; arguments as for `fit_light`."""
    samples = gather_samples(presses, for_fit=True)
    balls = [ball for _, of_press in presses for ball in of_press]
    surfaces = [_surface(image, of_press, inverse) for image, of_press in presses]

    def incoming(model: LightModel) -> Float64Array:
        found, first = np.zeros((len(samples.p), samples.intensity.shape[1])), 0
        for (_, of_press), surface in zip(presses, surfaces, strict=True):
            light = surface.incoming(model)
            here = (samples.ball >= first) & (samples.ball < first + len(of_press))
            row, column = (np.rint(at[here]).astype(np.intp) // surface.cell for at in (samples.row, samples.column))
            found[here] = light[row, column]
            first += len(of_press)
        return found

    return fit_light(samples, incoming, balls, apexes_px, presses[0][0].shape, positions)


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Cells of a press: intensity (h, w, C), slopes p and q and elevation in pixels, shape (h, w)."""

    cell: int
    intensity: Float64Array
    p: Float32Array
    q: Float32Array
    z_px: Float32Array

    def incoming(self, model: LightModel) -> Float64Array:
        """Return the light from other skin over that at rest: shape (h, w, C)."""
        size = self.z_px.shape
        row, column = middles_of_cells(size, self.cell)
        columns, rows = np.meshgrid(column, row)
        x, y, _ = model.places(columns.ravel(), rows.ravel(), np.zeros(columns.size))
        rest = model.rest(x, y).reshape(*size, -1)
        return incoming_light(self.intensity * rest, self.p, self.q, self.z_px / np.float32(self.cell)) / rest


def _surface(image: NormalizedImage, balls: Sequence[Ball], inverse: InverseMap) -> _Surface:
    """Return the surface of a press: its balls' spheres, and skin around them as the inverse map shows it."""
    read = evaluate(inverse, image)
    for ball in balls:
        row, column = pixels_inside(ball, image.shape)
        read.p[row, column], read.q[row, column] = sphere_slopes(
            ball, column.astype(np.float32), row.astype(np.float32)
        )
        read.valid[row, column] = True
    cell = cell_px(image.shape)
    p, q, known = cell_means(read.p, read.q, read.valid, cell)
    field = GradientField(p, q, np.ones(p.shape, np.bool_), np.where(known, 1.0, 0.1).astype(np.float32))
    height = integrate(field, float(cell))[0]
    z_px = find_datum(HeightMap(height.z_um, float(cell)), field).level(height).z_um
    intensity = np.nan_to_num(means_of_cells(image.values, (p.shape[0], p.shape[1]), cell), nan=1.0)
    return _Surface(cell, intensity, p, q, np.nan_to_num(z_px))


def held_out_readers(
    light: FittedLight,
    inverse: InverseMap,
    presses: Sequence[Press],
    elevation: ElevationCorrection,
    prior_sigma: float,
) -> OverCells:
    """Return what reads the balls of presses, with the model of all balls and without their own fold."""
    balls = [ball for _, of_press in presses for ball in of_press]

    def reader(model: LightModel, number: int) -> BallReader:
        return BallReader(light, model, inverse, balls[number], elevation, prior_sigma)

    return OverCells(
        [reader(light.model, number) for number in range(len(balls))],
        [reader(light.without(number), number) for number in range(len(balls))],
        cell_px(inverse.shape),
    )


def confirmed_fraction(
    light: FittedLight,
    maps: Sequence[InverseMap],
    presses: Sequence[Press],
    elevation: ElevationCorrection,
    prior_sigma: float,
) -> float:
    """Return the fraction of the light model's changes of slopes that leaves the least error on held-out balls, 0 to 1.

    Map and model are two estimates of the same slopes, and the fraction is their weight by least squares (Wolpert,
    "Stacked generalization", Neural Networks 5, 1992), up to slopes that the map reaches; errors of a centre do not
    count. A lone ball confirms nothing.

    maps : without every K-th ball, from each of the first K on; or one of all balls, by which the fraction is smaller
    """
    if len(light.folds) < 2:
        return 0.0
    agreed, square, number = 0.0, 1e-30, 0
    for image, balls in OverCells((), (), cell_px(presses[0][0].shape)).means_of(presses):
        for ball in balls:
            core = replace(ball, contact_radius_px=CORE_SHARE * ball.contact_radius_px)
            row, column = pixels_inside(core, image.shape)
            steep = np.hypot(*sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32)))
            some = np.flatnonzero(image.faithful[row, column] & (steep < MAP_REACH * light.model.steepest))
            some = some[:: max(1, len(some) // STACKED)]
            row, column = row[some], column[some]
            inverse, places = maps[number % len(maps)], (column.astype(np.float32), row.astype(np.float32))
            reader = BallReader(light, light.without(number), inverse, ball, elevation, prior_sigma)
            number += 1
            if not len(some):
                continue
            seen, truth = image.values[row, column], np.stack(sphere_slopes(ball, *places), axis=-1)
            read, all_of_it = inverse.predict(seen, *places), replace(light, confirmed=1.0)
            best = replace(reader, light=all_of_it).predict(seen, *places)
            scale = 1.0 / (1.0 + (truth**2).sum(axis=1, keepdims=True))
            change, error = scale * (best - read), scale * (truth - read)
            change, error = change - change.mean(axis=0), error - error.mean(axis=0)
            agreed += float((change * error).mean())
            square += float((change * change).mean())
    fraction = float(np.clip(agreed / square, 0.0, 1.0))
    return fraction if fraction >= MIN_CONFIRMED else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class BallReader:
    """The corrected slopes of one ball's pixels.

    light : of the calibration
    model : fitted without the ball, or to all balls
    elevation : at which the balls show slopes
    prior_sigma : standard uncertainty of the inverse map's slopes
    """

    light: FittedLight
    model: LightModel
    inverse: InverseMap
    ball: Ball
    elevation: ElevationCorrection
    prior_sigma: float

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Return slopes p and q, float64 array of shape (N, 2), of intensities (N, C) at pixels (N,)."""
        read = self.inverse.predict(intensity, column, row)
        p, q = sphere_slopes(self.ball, column, row)
        drop = self.elevation.radius_px * (1.0 - 1.0 / np.sqrt(1.0 + p * p + q * q))
        z_px = np.maximum(self.elevation.apex_px - drop, 0.0)
        count = len(read)
        places = column.astype(np.float64), row.astype(np.float64)
        seen, everywhere, flat = intensity.astype(np.float64), np.ones(count, np.bool_), np.zeros_like(read)
        cells = Cells(
            self.model, (1, count), 1, *places, seen, everywhere, read, flat, self.light.search_sigma(self.prior_sigma)
        )
        found = CellSlopes.level(cells)
        found = cells.solve_at(found, np.asarray(z_px, np.float32).reshape(1, -1), READER_STEPS)
        return read + cells.confirmed_change(found, self.light.confirmed)
