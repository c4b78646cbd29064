"""Fits the inverse map to balls, judged by balls that the fit did not see.

The penalty and the degree in position are those with the least error on held-out balls (whole balls, five folds).
Centres are then refined (see `centre_refinement`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from device.ball import Ball, BallSamples
from device.centre_refinement import Learners, Refined, refine, true_slopes
from device.colour_domain import ColourDomain
from device.curve_readings import LightCurve, NearCurve
from device.errors import CalibrationError
from device.held_out_ridge import angle_between_deg
from device.inverse_map import InverseMap
from device.light_field import LightField
from device.near_field import NearField
from device.slope_curve import SlopeCurve
from device.slope_learner import (
    FEWEST_FOR_MANY_TERMS,
    CurveForm,
    SlopeLearner,
    learner_of,
    near_learner,
    preferred_learner,
)
from device.surface import Float64Array, MaskArray

LONE_BALL_FORM: Final = CurveForm(4, 0)
LONE_BALL_PENALTY: Final = 1e-3
DISTRUST_POWER: Final = 20.0
"""Power of its held-out error with which a curve loses weight: an error larger by 10 % leaves a seventh."""

LEAST_SHARE: Final = 0.1
"""A curve of light with less weight is left out: it would cost as much as one that helps."""

NEAR_GAIN: Final = 0.975
"""Share of the held-out error of intensity's curve that a curve of near lights' slopes must reach to take its place.

It costs a third more; and a gain of one per cent on oem-bga's balls was lost again beside the curve of light.
"""

BAND_EDGES_DEG: Final = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 90.0)
FEWEST_PIXELS: Final = 500


@dataclass(frozen=True, slots=True)
class SlopeBand:
    """Held-out error of the pixels whose surface is tilted between two angles."""

    from_deg: float
    to_deg: float
    error_deg: float
    pixels: int


@dataclass(frozen=True, slots=True, eq=False)
class InverseFit:
    """A fitted map and what held-out balls say of it.

    map : the inverse map, fitted to all kept balls
    balls : every ball in the order of the samples, with refined centres
    kept : bool array of shape (balls,), False where a ball does not follow the sphere
    ball_error_deg : float64 array of shape (balls,), held-out mean angular error of the normal; NaN when unknown
    held_out_deg : the same over all pixels of kept balls, None when there is one ball only
    bands : the same by slope
    """

    map: InverseMap
    balls: tuple[Ball, ...]
    kept: MaskArray
    ball_error_deg: Float64Array
    held_out_deg: float | None
    bands: tuple[SlopeBand, ...]


def fit_inverse_map(
    samples: BallSamples,
    balls: Sequence[Ball],
    shape: tuple[int, int],
    *,
    max_samples: int = 40_000,
    light: LightField | None = None,
) -> InverseFit:
    """The inverse map of a full-size field of `shape` (H, W) from samples of `balls`, with its held-out errors.

    light : of untouched skin, for curves that want a reference, where held-out balls gain by them

    Raises
    ------
    CalibrationError
        The balls cover too few valid pixels.
    """
    chosen = _thinned(samples, max_samples)
    if len(chosen.p) < FEWEST_PIXELS:
        raise CalibrationError(
            f"the balls cover only {len(chosen.p)} usable pixels: press the ball deeper or lower the exposure"
        )
    everyone = np.ones(len(balls), bool)
    slope = true_slopes(chosen, balls)
    if len(balls) == 1:
        learner = learner_of(chosen, shape, LONE_BALL_FORM, LONE_BALL_PENALTY)
        solution = learner.ridge.solve(learner.penalty, slope, np.ones(len(slope)), everyone)
        domain = ColourDomain.observed(samples.intensity)
        fitted = InverseMap(shape, domain, learner.curve(solution), balls[0].steepest)
        return InverseFit(fitted, tuple(balls), everyone, np.array([np.nan]), None, ())
    plain, learners = _learners(chosen, slope, len(balls), shape, light)
    state = refine(chosen, balls, learners)
    if not state.kept.any():
        raise CalibrationError(
            "no ball follows the sphere well enough to teach: press the ball again, deeper and centred"
        )
    rows = state.kept[chosen.ball]
    domain = ColourDomain.observed(samples.intensity[state.kept[samples.ball]])
    error = angle_between_deg(state.held_out[rows], state.slope[rows])
    steepest = max(ball.steepest for ball, follows in zip(balls, state.kept, strict=True) if follows)
    return InverseFit(
        map=_map(plain, learners, state, domain, shape, steepest),
        balls=state.balls,
        kept=state.kept,
        ball_error_deg=state.errors_deg,
        held_out_deg=float(error.mean()),
        bands=_bands(error, state.slope[rows]),
    )


def _learners(
    samples: BallSamples, slope: Float64Array, count: int, shape: tuple[int, int], light: LightField | None
) -> tuple[SlopeLearner, Learners]:
    """The learner of intensity; and the map's: it or near lights', and light's where that is worth its cost."""
    plain, error = preferred_learner(samples, slope, count, shape)
    if light is None:
        return plain, [(plain, 1.0)]
    own = plain
    if count >= FEWEST_FOR_MANY_TERMS:
        near, near_error = near_learner(samples, slope, count, shape)
        if near_error < NEAR_GAIN * error:
            own, error = near, near_error
    lit, light_error = preferred_learner(samples, slope, count, shape, light)
    share = 1.0 / (1.0 + (light_error / error) ** DISTRUST_POWER)
    return plain, [(own, 1.0)] if share < LEAST_SHARE else [(own, 1.0 - share), (lit, share)]


def _thinned(samples: BallSamples, count: int) -> BallSamples:
    """At most `count` samples, drawn without replacement from a fixed seed."""
    if len(samples.p) <= count:
        return samples
    index = np.sort(np.random.default_rng(0).permutation(len(samples.p))[:count])
    return BallSamples(
        intensity=samples.intensity[index],
        p=samples.p[index],
        q=samples.q[index],
        column=samples.column[index],
        row=samples.row[index],
        ball=samples.ball[index],
    )


def _map(
    plain: SlopeLearner,
    learners: Learners,
    state: Refined,
    domain: ColourDomain,
    shape: tuple[int, int],
    steepest: float,
) -> InverseMap:
    """The map that all kept balls teach."""

    def taught(learner: SlopeLearner) -> SlopeCurve:
        return learner.curve(learner.ridge.solve(learner.penalty, state.slope, state.weight, state.kept))

    light, near = None, None
    for learner, share in learners:
        if isinstance(learner.reading, LightField):
            light = LightCurve(learner.reading, taught(learner), share)
        elif isinstance(learner.reading, NearField):
            near = NearCurve(learner.reading, taught(learner))
    leverage = plain.leverage(state.slope, state.weight, state.kept)
    return InverseMap(shape, domain, taught(plain), steepest, light, leverage, near)


def _bands(error_deg: Float64Array, slope: Float64Array) -> tuple[SlopeBand, ...]:
    tilt = np.degrees(np.arctan(np.linalg.norm(slope, axis=1)))
    bands = []
    for low, high in pairwise(BAND_EDGES_DEG):
        inside = (tilt >= low) & (tilt < high)
        if inside.any():
            bands.append(SlopeBand(low, high, float(error_deg[inside].mean()), int(inside.sum())))
    return tuple(bands)
