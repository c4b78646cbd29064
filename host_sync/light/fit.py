"""Calibration of the light model: a bundle adjustment of sources, coat, albedo, residual field and ball centres.

Damped Gauss-Newton steps minimise robust errors of the intensity of the balls' pixels together with broad priors
(Triggs et al., "Bundle adjustment", 2000). Sources are added and the prior of the residual field is widened as long as
that lowers the error of held-out balls, which follows from the normal equations without those balls. Light from skin to
skin in the presses is taken out before; held-out balls are read with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from device.balls.sphere import Ball, BallSamples, gather_samples, pixels_inside, sphere_slopes
from device.calibration.fit import CORE_FRACTION
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import Float32Array, Float64Array, GradientField, HeightMap
from host_sync.gradients.inverse_map_kernel import evaluate
from host_sync.integration.datum import cell_means
from host_sync.integration.integrate import integrate
from host_sync.integration.zero_level import find_datum
from host_sync.kernels.cell_rows import cell_px, means_of_cells, middles_of_cells
from host_sync.light.bundle import OUTLYING, Bundle
from host_sync.light.cells import MAP_REACH, Cells, CellSlopes
from host_sync.light.kernel_derivatives import Numbers
from host_sync.light.kernels import incoming_light
from host_sync.light.model import LightModel
from host_sync.uncertainty.elevation import ElevationCorrection
from host_sync.uncertainty.slope_error import OverCells

STARTS: Final = ((0.35, 0.45), (0.5, 0.2))
"""Height and length of the sources, in widths of the field, from which searches begin."""
MAX_ADDED: Final = 2
"""Sources that are added to the first one of each channel, at most."""
RESIDUAL_SIGMAS: Final = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Prior standard deviations of the residual field's coefficients that are tried."""
MIN_GAIN: Final = 0.98
"""Held-out error, relative to that before, which a model with one source more a channel or a wider residual field must
reach, and which every source must pay for against a model without sources."""


WIDENING: Final = 4.0
"""Standard uncertainty of the inverse map's slopes in a search without sources, relative to that on held-out balls: map
and model are two estimates there, which `FittedLight.confirmed` weighs."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedLight:
    """The light model of a calibration.

    model : fitted to all balls; without sources where these predict held-out balls no better than a polynomial does
    folds : fitted without every K-th ball, from each of the first K on
    shift_px : float64 array of shape (balls, 2), what the fit adds to each centre's column and row
    confirmed : fraction of what the model changes of slopes that held-out balls confirm
    """

    model: LightModel
    folds: tuple[LightModel, ...]
    shift_px: Float64Array
    confirmed: float = 1.0

    @property
    def has_sources(self) -> bool:
        """True where sources explain the balls: else a polynomial of the normal and the place does."""
        return len(self.model.sources) > 0

    def search_sigma(self, prior_sigma: float) -> float:
        """Return the standard uncertainty of the inverse map's slopes in the search, from that on held-out balls."""
        return prior_sigma if self.has_sources else WIDENING * prior_sigma

    def without(self, ball: int) -> LightModel:
        """Return the model without the fold of the ball of this number."""
        return self.folds[ball % len(self.folds)]

    def for_shape(self, shape: tuple[int, int]) -> FittedLight:
        """Return the model of the same field at (H, W) pixels: its lengths are in widths of the field."""
        folds = tuple(replace(fold, shape=shape) for fold in self.folds)
        return replace(self, model=replace(self.model, shape=shape), folds=folds)


def fit_light(
    samples: BallSamples,
    incoming: Callable[[LightModel], Float64Array],
    balls: Sequence[Ball],
    apexes_px: Sequence[float],
    shape: tuple[int, int],
    positions: Float64Array | None = None,
) -> FittedLight:
    """Return the light model that balls of a full-size field of `shape` (H, W) show.

    samples : of the balls
    incoming : light from skin around the samples over that at rest, shape (N, C), for a model of the light at rest
    apexes_px : elevation of each ball's apex over skin at rest, pixels
    positions : stated places of the sources, shape (C, 3), in widths of the field; None where they are not known
    """
    bundle = Bundle.of(samples, balls, apexes_px, shape)
    searches = [bundle.solve(bundle.start(*start, positions)) for start in STARTS]
    found = min(searches, key=lambda one: float(np.square(bundle.errors(one)).mean()))
    model = bundle.model(found)
    bundle = replace(bundle, incoming=incoming(model)[bundle.rows])
    bundle = bundle.with_sigma_of(found)
    found = bundle.solve(found)
    if _sources_predict(bundle, found):
        bundle, found = _with_more_sources(bundle, found)
        source_sigma = bundle.held_out_sigma(found)
        bundle, found = _with_residual(bundle, found)
    else:
        # A ball shows each tilt at one elevation: without sources, the two cannot be separated.
        source_sigma = np.sqrt(np.square(bundle.intensity - 1.0).mean(axis=0))
        bundle, found = _with_residual(bundle, bundle.without_sources(found), "normals")
    sigma = bundle.held_out_sigma(found)
    model, *folds = (
        replace(bundle.model(numbers), sigma=sigma, source_sigma=source_sigma)
        for numbers in (found, *(without for _, without in bundle.without(found)))
    )
    return FittedLight(model, tuple(folds), found.shift)


def _sources_predict(bundle: Bundle, numbers: Numbers) -> bool:
    """Return whether sources predict held-out balls better than the residual field alone does, for what they cost."""
    (plain, polynomial), (fitted, found) = (
        _with_residual(bundle, these) for these in (bundle.without_sources(numbers), numbers)
    )
    is_better = fitted.held_out(found) <= MIN_GAIN ** len(found.place) * plain.held_out(polynomial)
    return is_better and bundle.model(numbers).lights_field


def _with_more_sources(bundle: Bundle, found: Numbers) -> tuple[Bundle, Numbers]:
    """Return the fit with as many sources as pay for themselves on held-out balls."""
    held_out = bundle.held_out(found)
    for _ in range(MAX_ADDED):
        more = bundle.solve(with_source(bundle, found))
        again = bundle.held_out(more)
        if again > MIN_GAIN ** len(found.haze) * held_out or not bundle.model(more).lights_field:
            break
        bundle = bundle.with_sigma_of(more)
        found, held_out = more, bundle.held_out(more)
    return bundle, found


def _with_residual(
    bundle: Bundle, numbers: Numbers, stage: Literal["residual", "normals"] = "residual"
) -> tuple[Bundle, Numbers]:
    """Return the fit with a residual field over fixed sources, of the narrowest prior that no wider one beats."""
    best, least = (bundle, numbers), np.inf
    for sigma in RESIDUAL_SIGMAS:
        # From the same numbers each time: a narrow field moves the balls' centres far off.
        wider = replace(bundle, residual_sigma=sigma, stage=stage)
        found = wider.solve(numbers)
        held_out = wider.held_out(found)
        if held_out < MIN_GAIN * least:
            best, least = (wider, found), held_out
    return best


def with_source(bundle: Bundle, numbers: Numbers) -> Numbers:
    """Return the numbers with one source more a channel, where it explains most of what is left."""
    terms, model = bundle.terms(numbers), bundle.model(numbers)
    missing = bundle.intensity - terms.shown
    weight = 1.0 / (bundle.sigma**2 + np.square(missing / OUTLYING))
    angle, near, slant = np.meshgrid(np.arange(16) * (np.pi / 8), (0.4, 0.8), (0.25, 0.6, 1.2), indexing="ij")
    places = np.stack([near * np.cos(angle), near * np.sin(angle), near * slant], axis=-1).reshape(-1, 3)
    tried = np.concatenate([places, np.full((len(places), 2), 0.2)], axis=1)
    lit = terms.lit
    level = np.zeros_like(lit.p)
    one_each = replace(model, sources=tried)
    light = one_each.light(lit.p, lit.q, bundle.x, bundle.y, lit.z)
    rest = one_each.light(level, level, bundle.x, bundle.y, level)
    chosen, strengths = [], np.zeros((missing.shape[1], missing.shape[1]))
    for channel in range(missing.shape[1]):
        change = (light - terms.ratio[:, channel, None] * rest) / terms.at_rest[:, channel, None]
        weighted = weight[:, channel, None] * change
        bright = (weighted * missing[:, channel, None]).sum(axis=0) / np.maximum((weighted * change).sum(axis=0), 1e-12)
        gain = np.maximum(bright, 0.0) * (weighted * missing[:, channel, None]).sum(axis=0)
        best = int(np.argmax(gain))
        chosen.append(tried[best])
        strengths[channel, channel] = np.clip(bright[best], 0.0, 0.3)
    added = np.array(chosen)
    place = np.concatenate([added[:, :2], np.log(added[:, 2:3])], axis=1)
    return replace(
        numbers, place=np.concatenate([numbers.place, place]),
        extent=np.concatenate([numbers.extent, added[:, 3:]]),
        strength=np.concatenate([numbers.strength, strengths], axis=1),
    )  # fmt: skip


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
            core = replace(ball, contact_radius_px=CORE_FRACTION * ball.contact_radius_px)
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
