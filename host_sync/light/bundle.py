"""Errors of the intensity of balls' pixels, their derivatives, and damped Gauss-Newton steps: see `fit`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.surface import Float64Array
from host_sync.light.kernel_derivatives import (
    COAT,
    COAT_SIGMA,
    COAT_START,
    EXTENT,
    Jacobian,
    Numbers,
    light_derivatives,
)
from host_sync.light.model import PLACES, TERMS, LightModel, place_terms, residual_terms

SAMPLES: Final = 3000
FOLDS: Final = 6
STEEPEST_QUANTILE: Final = 0.98
"""Quantile of the samples' slopes up to which they count as seen."""

FIRST_SIGMA: Final = 0.03
MIN_SIGMA: Final = 0.004
OUTLYING: Final = 4.0
"""Standard deviations at which an error counts half."""
OUTLIER_BOUND: Final = 6.0
"""Standard deviations that bound a held-out error."""
CENTRE_SIGMA: Final = 0.015
"""Prior standard deviation of a centre's error, relative to the ball's radius."""
PRIOR_SAMPLES: Final = 300.0
"""Samples that priors of sources and coat outweigh."""
FIRST_HEIGHT: Final = 0.3
"""Height of a source's own, relative to its elevation, from which the search begins."""
FIXED: Final = 1e-9
"""Prior standard deviation of numbers that are known."""
GENTLE: Final = 0.35
"""Slopes up to which samples place the first sources."""
ROUNDS: Final = 60
TOLERANCE: Final = 1e-5
DAMPINGS: Final = 8
CENTRE_STEP_PX: Final = 0.05
_OF_SOURCES: Final = ("place", "extent", "strength", "haze", "albedo", "coat")


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Samples whose intensity a model predicts; lengths in pixels but for x and y.

    rows : numbers of the samples among all
    coat : its expected numbers, in the order of `COAT`, and their prior standard deviations: that of the camera is
        `FIXED` where its height is known
    incoming : light from around over that at rest, shape (N, C)
    sigma : float64 array of shape (C,), standard deviation of the intensity's error
    steepest : slope up to which the samples are dense
    residual_sigma : prior standard deviation of the residual's coefficients
    stage : what is searched for besides the balls' centres: numbers of sources, or the residual, of which elevation is
        a part or not; the other numbers stay
    """

    rows: np.ndarray
    intensity: Float64Array
    column: Float64Array
    row: Float64Array
    x: Float64Array
    y: Float64Array
    ball: np.ndarray
    balls: Sequence[Ball]
    apex_px: Float64Array
    shape: tuple[int, int]
    coat: tuple[Float64Array, Float64Array]
    incoming: Float64Array
    places: Float64Array
    sigma: Float64Array
    steepest: float
    residual_sigma: float = 0.003
    stage: Literal["sources", "residual", "normals"] = "sources"
    _lit: dict[str, _Lit] = field(default_factory=dict)

    @classmethod
    def of(
        cls, samples: BallSamples, balls: Sequence[Ball], apexes_px: Sequence[float], shape: tuple[int, int]
    ) -> Bundle:
        """Return at most `SAMPLES` of the samples, with skin around that is level; arguments as for `fit_light`."""
        rows = np.random.default_rng(0).permutation(len(samples.p))[:SAMPLES]
        column, row = samples.column[rows].astype(np.float64), samples.row[rows].astype(np.float64)
        x, y = (column - 0.5 * (shape[1] - 1)) / shape[1], (row - 0.5 * (shape[0] - 1)) / shape[1]
        seen = samples.training_intensity[rows].astype(np.float64)
        tilted = 1.0 - 1.0 / np.sqrt(1.0 + samples.p[rows] ** 2 + samples.q[rows] ** 2)
        floor = np.repeat(0.5 * tilted[:, None].astype(np.float64), seen.shape[1], axis=1)
        viewpoint = balls[0].viewpoint
        coat, coat_sigma = COAT_START.copy(), COAT_SIGMA.copy()
        if viewpoint is not None:
            camera = COAT.index("camera")
            coat[camera], coat_sigma[camera] = shape[1] / viewpoint.height_px, FIXED
        return cls(
            rows, seen, column, row, x, y, samples.ball[rows], balls, np.array(apexes_px), shape, (coat, coat_sigma),
            floor, place_terms(x, y, shape), np.full(seen.shape[1], FIRST_SIGMA),
            float(np.quantile(np.hypot(samples.p, samples.q), STEEPEST_QUANTILE)),
        )  # fmt: skip

    def sphere(self, shift: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return slopes and elevations, in widths of the field, of the samples' balls."""
        centre = (np.array([[one.column, one.row] for one in self.balls]) + shift)[self.ball]
        radius = np.array([one.radius_px for one in self.balls])[self.ball]
        apex, viewpoint = self.apex_px[self.ball], self.balls[0].viewpoint
        pixel = np.stack([self.column, self.row])
        across, down = pixel - centre.T
        if viewpoint is not None:
            across, down = viewpoint.offsets_from_axis(pixel, centre.T, radius, apex)
        rise = np.sqrt(np.maximum(radius**2 - across**2 - down**2, 1.0))
        return -across / rise, -down / rise, (apex - radius + rise) / self.shape[1]

    def start(self, height: float, length: float, positions: Float64Array | None) -> Numbers:
        """Return one source a channel, in the direction that gentle slopes show."""
        channels = self.intensity.shape[1]
        p, q, _ = self.sphere(np.zeros((len(self.balls), 2)))
        gentle = np.hypot(p, q) < GENTLE
        terms = np.stack([p, q, self.x * p, self.y * p, self.x * q, self.y * q], axis=-1)[gentle]
        lit = self.intensity[gentle] * np.sqrt(1.0 + p * p + q * q)[gentle, None] - 1.0
        slants = np.clip(np.linalg.lstsq(terms, lit, rcond=None)[0][:2], -3.0, 3.0)
        place = np.concatenate([-height * slants.T, np.full((channels, 1), np.log(height))], axis=1)
        if positions is not None:
            place = np.concatenate([positions[:, :2], np.log(np.maximum(positions[:, 2:], 0.05))], axis=1)
        return Numbers(
            place,
            np.repeat([[length, FIRST_HEIGHT]], channels, axis=0),
            0.9 * np.eye(channels) + 0.1 / channels,
            np.full(channels, 0.01),
            np.array([0.3]),
            self.coat[0].copy(),
            np.zeros((len(self.balls), 2)),
            np.zeros((channels, TERMS * PLACES)),
        )

    def model(self, numbers: Numbers) -> LightModel:
        """Return the model of these numbers."""
        fall_off, roughness, gloss, width, tail, tilt_gain, beam, camera, scattering = numbers.coat.tolist()
        residual = numbers.residual.reshape(len(numbers.haze), TERMS, PLACES)
        return LightModel(
            self.shape, numbers.sources, numbers.strength, numbers.haze, float(numbers.albedo[0]), fall_off, roughness,
            gloss, float(np.exp(width)), float(np.exp(tail)), tilt_gain, beam, camera, scattering, residual, self.sigma,
            self.sigma, self.steepest,
        )  # fmt: skip

    def errors(self, numbers: Numbers) -> Float64Array:
        """Return the predicted less seen intensity, shape (N, C)."""
        return self.terms(numbers).shown - self.intensity

    def terms(self, numbers: Numbers, *, keep: bool = True) -> _Terms:
        """Return the predicted intensity and its parts.

        keep : the light of these numbers for the next call, which often has the same sources or centres
        """
        lit = self._light(numbers, keep=keep)
        model = self.model(numbers)
        at_rest = np.maximum(model.mixed(lit.rest), 1e-6)
        ratio = model.mixed(lit.light) / at_rest
        shown = ratio + model.albedo * self.incoming + lit.features @ numbers.residual.T
        return _Terms(np.nan_to_num(shown, nan=30.0), lit, ratio, at_rest)

    def _light(self, numbers: Numbers, *, keep: bool) -> _Lit:
        sources = (numbers.place.tobytes(), numbers.extent.tobytes(), numbers.coat.tobytes())
        before, shift = self._lit.get("last"), numbers.shift.tobytes()
        if before is not None and before.sources != sources:
            before = None
        if before is not None and before.shift == shift:
            return before
        p, q, z = self.sphere(numbers.shift)
        model, level = self.model(numbers), np.zeros_like(p)
        light = model.light(p, q, self.x, self.y, z)
        rest = model.light(level, level, self.x, self.y, level) if before is None else before.rest
        features = (residual_terms(p, q, z)[:, :, None] * self.places[:, None]).reshape(len(p), -1)
        found = _Lit(sources, shift, p, q, z, light, rest, features)
        if keep:
            self._lit["last"] = found
        return found

    def _source_columns(self, numbers: Numbers, terms: _Terms) -> Iterator[Float64Array]:
        """Yield derivatives of the intensity (N, C) by the numbers of sources and coat, in their order."""
        lit = terms.lit
        model, level = self.model(numbers), np.zeros_like(lit.p)
        skin, ground = (lit.p, lit.q, self.x, self.y, lit.z), (level, level, self.x, self.y, level)
        by_source, by_coat = light_derivatives(numbers, model, skin, lit.light)
        source_below, coat_below = light_derivatives(numbers, model, ground, lit.rest)
        for axes in (range(3), range(3, EXTENT)):
            for source in range(len(numbers.place)):
                for axis in axes:
                    less = by_source[:, source, axis, None] - terms.ratio * source_below[:, source, axis, None]
                    yield less * model.strengths[:, source] / terms.at_rest
        channels = self.intensity.shape[1]
        for channel in range(channels):
            for source in range(len(numbers.place)):
                change = np.zeros_like(terms.shown)
                less = lit.light[:, source] - terms.ratio[:, channel] * lit.rest[:, source]
                change[:, channel] = less / terms.at_rest[:, channel]
                yield change
        for channel in range(channels):
            change = np.zeros_like(terms.shown)
            change[:, channel] = (1.0 - terms.ratio[:, channel]) / terms.at_rest[:, channel]
            yield change
        yield self.incoming
        for number in range(len(COAT)):
            change, below = (part[..., number] @ model.strengths.T for part in (by_coat, coat_below))
            yield (change - terms.ratio * below) / terms.at_rest

    def _by_shift(self, numbers: Numbers, terms: _Terms) -> Float64Array:
        """Return derivatives of the intensity by the shift of each sample's own ball: shape (N, C, 2)."""
        shifted = []
        for axis in (0, 1):
            shift = numbers.shift.copy()
            shift[:, axis] += CENTRE_STEP_PX
            there = self.terms(replace(numbers, shift=shift), keep=False)
            shifted.append((there.shown - terms.shown) / CENTRE_STEP_PX)
        return np.stack(shifted, axis=-1)

    def _prior(self, numbers: Numbers) -> tuple[Float64Array, Float64Array]:
        """Return the expected values of all numbers, and weights of their differences from them."""
        weight = len(self.ball) / PRIOR_SAMPLES
        radius = np.array([one.radius_px for one in self.balls])
        residual = np.full((len(numbers.haze), TERMS, PLACES), self.residual_sigma * np.sqrt(weight))
        if self.stage == "normals":
            residual[:, -1] = FIXED
        expected = replace(
            numbers, extent=np.full_like(numbers.extent, 0.2), haze=np.zeros_like(numbers.haze),
            albedo=np.array([0.4]), coat=self.coat[0], shift=np.zeros_like(numbers.shift),
            residual=np.zeros_like(numbers.residual),
        )  # fmt: skip
        sigmas = replace(
            numbers, place=np.full_like(numbers.place, 10.0), extent=np.full_like(numbers.extent, 0.5),
            strength=np.ones_like(numbers.strength), haze=np.full_like(numbers.haze, 0.05), albedo=np.array([0.5]),
            coat=self.coat[1], shift=np.repeat(CENTRE_SIGMA * radius[:, None], 2, axis=1) * np.sqrt(weight),
            residual=residual.reshape(numbers.residual.shape),
        )  # fmt: skip
        return expected.packed(), weight / sigmas.packed() ** 2

    def _free(self, numbers: Numbers) -> slice:
        """Return the numbers that are searched for, among all: shifts and what stands before or after them."""
        before = sum(getattr(numbers, name).size for name in _OF_SOURCES)
        return slice(0, before + numbers.shift.size) if self.stage == "sources" else slice(before, None)

    def solve(self, numbers: Numbers) -> Numbers:
        """Return the numbers of the smallest cost near these."""
        damping, cost, free = 1e-3, self._cost(numbers), self._free(numbers)
        for _ in range(ROUNDS):
            system, gradient, _ = self._system(numbers)
            for _ in range(DAMPINGS):
                damped = system + damping * np.diag(np.diag(system))
                there = _stepped(numbers, free, damped, gradient)
                reached = self._cost(there)
                if reached < cost:
                    break
                damping *= 6.0
            else:
                return numbers
            done = cost - reached < TOLERANCE * cost
            numbers, cost, damping = there, reached, max(damping / 6.0, 1e-6)
            if done:
                break
        return numbers

    def _cost(self, numbers: Numbers) -> float:
        error = self.errors(numbers) / self.sigma
        expected, weight = self._prior(numbers)
        robust = OUTLYING**2 * np.log1p(np.square(error / OUTLYING))
        return float(robust.sum() + (weight * np.square(numbers.packed() - expected)).sum())

    def _system(self, numbers: Numbers) -> tuple[Float64Array, Float64Array, Jacobian]:
        """Return matrix and right side of the normal equations of the free numbers, and the Jacobian."""
        terms = self.terms(numbers)
        error = terms.shown - self.intensity
        features = terms.lit.features
        if self.stage == "sources":
            shared, features = np.stack(list(self._source_columns(numbers, terms)), axis=-1), features[:, :0]
        else:
            shared = np.zeros((*error.shape, 0))
        weight = 1.0 / (self.sigma**2 + np.square(error / OUTLYING))
        by_shift = self._by_shift(numbers, terms)
        jacobian = Jacobian(shared, by_shift, self.ball, len(self.balls), features, error, weight)
        system, gradient = jacobian.normal_equations(slice(None))
        expected, prior = (part[self._free(numbers)] for part in self._prior(numbers))
        system[np.diag_indices_from(system)] += prior
        return system, gradient + prior * (numbers.packed()[self._free(numbers)] - expected), jacobian

    def without(self, numbers: Numbers) -> Iterator[tuple[int, Numbers]]:
        """Yield numbers without each fold of balls, by one step of the normal equations without it."""
        system, gradient, jacobian = self._system(numbers)
        for fold in range(min(FOLDS, len(self.balls))):
            less, lost = jacobian.normal_equations(self.ball % FOLDS == fold)
            rest = system - less
            rest[np.diag_indices_from(rest)] *= 1.0 + 1e-6
            values = numbers.packed()
            values[self._free(numbers)] -= np.linalg.solve(rest, gradient - lost)
            yield fold, numbers.unpacked(values)

    def held_out(self, numbers: Numbers) -> float:
        """Return the robust error of held-out balls, in standard deviations."""
        error = self.held_out_errors(numbers) / self.sigma
        return float(np.sqrt((OUTLYING**2 * np.log1p(np.square(error / OUTLYING))).mean()))

    def held_out_sigma(self, numbers: Numbers) -> Float64Array:
        """Return the root mean square of held-out errors that are bounded: shape (C,)."""
        bound = OUTLIER_BOUND * self.sigma
        return np.asarray(np.sqrt(np.square(np.clip(self.held_out_errors(numbers), -bound, bound)).mean(axis=0)))

    def held_out_errors(self, numbers: Numbers) -> Float64Array:
        """Return errors of the intensity of every ball without its fold, shape (N, C)."""
        found = self.errors(numbers)
        for fold, without in self.without(numbers):
            here = self.ball % FOLDS == fold
            found[here] = self.errors(replace(without, shift=numbers.shift))[here]
        return found

    def with_sigma_of(self, numbers: Numbers) -> Bundle:
        """Return the bundle with the standard deviations that a fit leaves."""
        sigma = 1.4826 * np.median(np.abs(self.errors(numbers)), axis=0)
        return replace(self, sigma=np.maximum(sigma, MIN_SIGMA))

    def without_sources(self, numbers: Numbers) -> Numbers:
        """Return the numbers of a model whose residual field explains all."""
        channels = len(numbers.haze)
        return replace(
            numbers, place=np.zeros((0, 3)), extent=np.zeros((0, 2)), strength=np.zeros((channels, 0)),
            haze=np.ones(channels), albedo=np.zeros(1), coat=self.coat[0].copy(),
            shift=np.zeros_like(numbers.shift), residual=np.zeros_like(numbers.residual),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Lit:
    """Light of sources on the samples (N, S), and what it follows from.

    sources, shift : numbers of sources and coat, and shifts of the centres, as bytes
    p, q, z : slopes and elevations of the samples, shape (N,)
    light, rest : on them, and on skin at rest, shape (N, S)
    features : terms of the residual field, shape (N, terms)
    """

    sources: tuple[bytes, ...]
    shift: bytes
    p: Float64Array
    q: Float64Array
    z: Float64Array
    light: Float64Array
    rest: Float64Array
    features: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class _Terms:
    """Predicted intensity of the samples, shape (N, C), and its parts: light of sources over that at rest, and that."""

    shown: Float64Array
    lit: _Lit
    ratio: Float64Array
    at_rest: Float64Array


def _stepped(numbers: Numbers, free: slice, system: Float64Array, gradient: Float64Array) -> Numbers:
    """Return numbers after a step of normal equations, in which numbers that reach a bound stay at it."""
    start = numbers.packed()
    step, moves = np.zeros(len(gradient)), np.ones(len(gradient), np.bool_)
    while True:
        missing = gradient[moves] + system[np.ix_(moves, ~moves)] @ step[~moves]
        step[moves] = -np.linalg.solve(system[np.ix_(moves, moves)], missing)
        values = start.copy()
        values[free] += step
        there = numbers.unpacked(values)
        bounded = moves & (there.packed()[free] != values[free])
        if not bounded.any():
            return there
        step[bounded] = (there.packed() - start)[free][bounded]
        moves &= ~bounded
