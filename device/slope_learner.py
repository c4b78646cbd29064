"""A curve of the inverse map while it is being learned: its form, its penalty, and what it reads."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from device.ball import BallSamples
from device.colour_space import ColourSpace
from device.colour_waves import ColourWaves
from device.curve_readings import Reading
from device.held_out_ridge import HeldOutRidge
from device.leverage import Leverage
from device.light_field import LightField
from device.near_field import NearField
from device.polynomials import colour_exponents, field_position, position_exponents
from device.slope_curve import SlopeCurve, design_matrix
from device.stereographic import slope_from_stereographic
from device.surface import Float32Array, Float64Array, MaskArray

PENALTIES: Final = tuple(float(value) for value in 10.0 ** np.arange(-8.0, 1.0, 0.5))
FLAT_SHARE: Final = 0.1
"""Untouched skin, as a share of the ball pixels: it pins intensity 1 to slope 0 everywhere in the field."""


@dataclass(frozen=True, slots=True)
class CurveForm:
    """Which terms a curve has, and how dear they are.

    colour_degree, position_degree : its degrees
    place_penalty : how many times as dear a term is for every power of position
    waves : its waves of colour, none of them for a polynomial
    """

    colour_degree: int
    position_degree: int
    place_penalty: float = 1.0
    waves: ColourWaves = field(default_factory=ColourWaves.none)

    def term_scale(self) -> Float64Array:
        """What features are multiplied by so that one penalty serves all: float64 array of shape (M K,)."""
        powers = np.array([i + j for i, j in position_exponents(self.position_degree)])
        scale = self.place_penalty ** (-0.5 * powers)
        return np.tile(scale, len(colour_exponents(self.colour_degree)) + self.waves.count)


PLAIN_FORMS: Final = tuple(CurveForm(4, degree) for degree in (0, 1, 2))
NEAR_FORMS: Final = (CurveForm(4, 2), CurveForm(5, 2), CurveForm(5, 2, 10.0))
"""Forms of a curve that reads the slopes of a matt skin: what is left to do there bends more, and less over place."""

WAVY_GAIN: Final = 0.95
"""Share of the plain forms' held-out error that the wavy form must reach: it costs several times as much."""

FEWEST_FOR_MANY_TERMS: Final = 8
"""Balls from which a curve may have waves or read near lights' slopes: what few balls say of so much is chance."""


def wavy_form() -> CurveForm:
    """The form for a skin with metal flakes, which bends more over colour than over place."""
    return CurveForm(2, 2, 10.0, ColourWaves.drawn())


@dataclass(frozen=True, slots=True, eq=False)
class SlopeLearner:
    """A curve that is to be learned.

    colours : the variables that it is a polynomial in
    form : its terms
    reading : what makes its colours of intensity and place, None where it reads intensity itself
    penalty : of the ridge
    ridge : its features at the pixels of balls
    """

    colours: ColourSpace
    form: CurveForm
    reading: Reading | None
    penalty: float
    ridge: HeldOutRidge

    def leverage(self, slope: Float64Array, weight: Float64Array, alive: MaskArray) -> Leverage:
        """The leverage of its features among those of the living balls; arguments as for the ridge."""
        root = self.ridge.leverage_root(self.penalty, slope, weight, alive)
        found = Leverage.of(root, self.ridge.design[alive[self.ridge.ball]])
        scaled = (found.root * self.form.term_scale()[:, None]).astype(np.float32)
        return replace(found, root=scaled)

    def curve(self, solution: Float64Array) -> SlopeCurve:
        """The curve with the coefficients that `ridge` found, array of shape (F, 2)."""
        form = self.form
        unscaled = solution * form.term_scale()[:, None]
        coefficients = unscaled.reshape(-1, len(position_exponents(form.position_degree)), 2).astype(np.float32)
        return SlopeCurve(self.colours, form.colour_degree, form.position_degree, coefficients, form.waves)


def learner_of(
    samples: BallSamples, shape: tuple[int, int], form: CurveForm, penalty: float, reading: Reading | None = None
) -> SlopeLearner:
    """The learner of this form and penalty, for a full-size field of `shape` (H, W)."""
    place = field_position(samples.column.astype(np.float64), samples.row.astype(np.float64), shape)
    seen = _seen(samples.intensity, place, reading)
    colours = ColourSpace.observed(seen, linear=reading is not None)
    scale = form.term_scale()
    degrees = form.colour_degree, form.position_degree
    design = design_matrix(colours, *degrees, seen, place, form.waves) * scale
    count = max(int(FLAT_SHARE * len(samples.p)), 1)
    anywhere = np.random.default_rng(1).uniform(-1.0, 1.0, (count, 2))
    untouched = _seen(np.ones((count, 3), np.float32), anywhere, reading)
    flat = design_matrix(colours, *degrees, untouched, anywhere, form.waves) * scale
    return SlopeLearner(colours, form, reading, penalty, HeldOutRidge(design, flat.T @ flat, samples.ball))


def preferred_learner(
    samples: BallSamples, slope: Float64Array, count: int, shape: tuple[int, int], light: LightField | None = None
) -> tuple[SlopeLearner, float]:
    """The learner with the form and the penalty of least held-out error, and that error, in slope.

    Balls' centres do not count in the error.

    slope : float64 array of shape (N, 2), true slopes of the samples
    count : of balls
    light : for a curve that reads light
    """
    best = min((_at_best_penalty(samples, slope, count, shape, form, light) for form in PLAIN_FORMS), key=_error)
    if count < FEWEST_FOR_MANY_TERMS:
        return best
    wavy = _at_best_penalty(samples, slope, count, shape, wavy_form(), light)
    return wavy if wavy[1] < WAVY_GAIN * best[1] else best


def near_learner(
    samples: BallSamples, slope: Float64Array, count: int, shape: tuple[int, int]
) -> tuple[SlopeLearner, float]:
    """The best learner that reads the slopes of a matt skin under near lights, and its held-out error."""
    near = NearField.of(samples, slope, shape)
    return min((_at_best_penalty(samples, slope, count, shape, form, near) for form in NEAR_FORMS), key=_error)


def _at_best_penalty(
    samples: BallSamples,
    slope: Float64Array,
    count: int,
    shape: tuple[int, int],
    form: CurveForm,
    reading: Reading | None,
) -> tuple[SlopeLearner, float]:
    """The learner of this form with the penalty of least held-out error, and that error."""
    learner = learner_of(samples, shape, form, 0.0, reading)
    held_out = learner.ridge.held_out(PENALTIES, slope, np.ones(len(samples.p)), np.ones(count, bool))
    errors = [_balanced_error(samples, slope_from_stereographic(u), slope) for u in held_out]
    least = int(np.argmin(errors))
    return replace(learner, penalty=PENALTIES[least]), errors[least]


def _error(found: tuple[SlopeLearner, float]) -> float:
    """What learners are chosen by, one at a time: their features take a hundred megabytes."""
    return found[1]


def _seen(intensity: Float32Array, place: Float64Array, reading: Reading | None) -> Float32Array:
    return intensity if reading is None else reading.seen(intensity, place)


def _balanced_error(samples: BallSamples, slope: Float64Array, truth: Float64Array) -> float:
    """Mean absolute slope error after each ball's own median is taken out, so that centre errors do not count."""
    error = slope - truth
    for ball in np.unique(samples.ball):
        rows = samples.ball == ball
        error[rows] -= np.median(error[rows], axis=0)
    return float(np.abs(error).mean())
