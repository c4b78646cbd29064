"""Fits the inverse map to balls, judged by balls that the fit did not see.

The penalty and the degree in position are those with the least error on held-out balls (whole balls, five folds).
Ball centres come from images and are off by a pixel or so; each is moved to where the map learned from the *other*
balls puts it. Moving centres to fit a model of the same ball would only shrink the residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from device.ball import Ball, BallSamples
from device.colour_domain import ColourDomain
from device.errors import CalibrationError
from device.held_out_ridge import angle_between_deg, robust_weight
from device.inverse_map import InverseMap, LightCurve
from device.light_field import LightField
from device.slope_learner import CurveForm, SlopeLearner, learner_of, preferred_learner
from device.stereographic import slope_from_stereographic
from device.surface import Float64Array, MaskArray

REFINEMENT_ROUNDS: Final = 4
SHIFT_TAKEN: Final = 0.8
"""Share of a centre's indicated shift that is taken."""
LONE_BALL_FORM: Final = CurveForm(4, 0)
LONE_BALL_PENALTY: Final = 1e-3
DISTRUST_POWER: Final = 20.0
"""Power of its held-out error with which a curve loses weight: an error larger by 10 % leaves a seventh."""

LEAST_SHARE: Final = 0.1
"""A curve of light with less weight is left out: it would cost as much as one that helps."""

BAND_EDGES_DEG: Final = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 90.0)
FEWEST_PIXELS: Final = 500

STANDS_OUT: Final = 3.0
"""Deviations from the median error at which a ball no longer teaches."""

LEAST_DEVIATION: Final = 0.15
"""The deviation counts as this share of the median at least: a ball alone in a corner is predicted worse."""


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

    light : of untouched skin, for a second curve that reads light where held-out balls gain by it

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
    slope = _true_slopes(chosen, balls)
    if len(balls) == 1:
        learner = learner_of(chosen, shape, LONE_BALL_FORM, LONE_BALL_PENALTY)
        solution = learner.ridge.solve(learner.penalty, slope, np.ones(len(slope)), everyone)
        domain = ColourDomain.observed(samples.intensity)
        fitted = InverseMap(shape, domain, learner.curve(solution), balls[0].steepest)
        return InverseFit(fitted, tuple(balls), everyone, np.array([np.nan]), None, ())
    learners = _learners(chosen, slope, len(balls), shape, light)
    state = _refine(chosen, balls, learners)
    if not state.kept.any():
        raise CalibrationError(
            "no ball follows the sphere well enough to teach: press the ball again, deeper and centred"
        )
    rows = state.kept[chosen.ball]
    domain = ColourDomain.observed(samples.intensity[state.kept[samples.ball]])
    error = angle_between_deg(state.held_out[rows], state.slope[rows])
    steepest = max(ball.steepest for ball, follows in zip(balls, state.kept, strict=True) if follows)
    return InverseFit(
        map=_map(learners, state, domain, shape, steepest),
        balls=state.balls,
        kept=state.kept,
        ball_error_deg=state.errors_deg,
        held_out_deg=float(error.mean()),
        bands=_bands(error, state.slope[rows]),
    )


_Learners = Sequence[tuple[SlopeLearner, float]]
"""Learners with their shares, the one that reads intensity first."""


def _learners(
    samples: BallSamples, slope: Float64Array, count: int, shape: tuple[int, int], light: LightField | None
) -> _Learners:
    """The learner of intensity and, where it is worth its cost, that of light."""
    plain, error = preferred_learner(samples, slope, count, shape)
    if light is None:
        return [(plain, 1.0)]
    lit, light_error = preferred_learner(samples, slope, count, shape, light)
    share = 1.0 / (1.0 + (light_error / error) ** DISTRUST_POWER)
    return [(plain, 1.0)] if share < LEAST_SHARE else [(plain, 1.0 - share), (lit, share)]


@dataclass(slots=True, eq=False)
class _Refined:
    """Balls with moved centres, true slopes and weights of the samples that follow from them, held-out slopes."""

    balls: tuple[Ball, ...]
    slope: Float64Array
    weight: Float64Array
    kept: MaskArray
    errors_deg: Float64Array
    held_out: Float64Array


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


def _true_slopes(samples: BallSamples, balls: Sequence[Ball]) -> Float64Array:
    """Slopes of shape (N, 2) of the spheres at their present centres."""
    centre = np.array([[ball.column, ball.row] for ball in balls])[samples.ball]
    radius = np.array([ball.radius_px for ball in balls])[samples.ball]
    offset = np.stack([samples.column, samples.row], axis=-1) - centre
    height = np.sqrt(np.maximum(radius**2 - (offset**2).sum(axis=-1), (0.2 * radius) ** 2))
    return np.asarray(-offset / height[:, None])


def _refine(samples: BallSamples, balls: Sequence[Ball], learners: _Learners) -> _Refined:
    """Centres moved, balls that do not follow the sphere dropped, samples weighted: a few rounds of each."""
    slope = _true_slopes(samples, balls)
    count = len(balls)
    seen = np.bincount(samples.ball, minlength=count) > 0
    state = _Refined(tuple(balls), slope, np.ones(len(slope)), seen, np.full(count, np.nan), np.zeros_like(slope))
    for _ in range(REFINEMENT_ROUNDS):
        held_out = _held_out(learners, state)
        state.balls = _recentred(samples, balls, held_out, state.kept)
        state.slope = _true_slopes(samples, state.balls)
        state.weight = robust_weight(held_out, state.slope)
        angle = angle_between_deg(held_out, state.slope)
        pixels = np.maximum(np.bincount(samples.ball, minlength=count), 1)
        state.errors_deg = np.where(seen, np.bincount(samples.ball, angle, count) / pixels, np.nan)
        state.kept = _following(state.errors_deg)
    state.held_out = _held_out(learners, state)
    return state


def _held_out(learners: _Learners, state: _Refined) -> Float64Array:
    """Slopes of shape (N, 2) that the learners together give each ball without having seen it."""
    u = np.zeros_like(state.slope)
    for learner, share in learners:
        (own,) = learner.ridge.held_out([learner.penalty], state.slope, state.weight, state.kept)
        u += share * own
    return slope_from_stereographic(u)


def _map(
    learners: _Learners, state: _Refined, domain: ColourDomain, shape: tuple[int, int], steepest: float
) -> InverseMap:
    """The map that all kept balls teach."""
    curves = [
        learner.curve(learner.ridge.solve(learner.penalty, state.slope, state.weight, state.kept))
        for learner, _ in learners
    ]
    learner, share = learners[-1]
    light = None if learner.light is None else LightCurve(learner.light, curves[-1], share)
    leverage = learners[0][0].leverage(state.slope, state.weight, state.kept)
    return InverseMap(shape, domain, curves[0], steepest, light, leverage)


def _recentred(samples: BallSamples, balls: Sequence[Ball], slope: Float64Array, kept: MaskArray) -> tuple[Ball, ...]:
    """Balls moved towards where held-out slopes put their centres; the set's common shift is left out."""
    radius = np.array([ball.radius_px for ball in balls])[samples.ball]
    towards_apex = slope * (radius / np.sqrt(1.0 + (slope**2).sum(axis=-1)))[:, None]
    apex = np.stack([samples.column, samples.row], axis=-1) + towards_apex
    centre = np.array([[ball.column, ball.row] for ball in balls])
    shift = np.zeros_like(centre)
    for number in np.unique(samples.ball):
        shift[number] = np.median(apex[samples.ball == number], axis=0) - centre[number]
    shift = SHIFT_TAKEN * (shift - np.median(shift[kept], axis=0))
    moved = centre + shift
    return tuple(
        replace(ball, column=float(column), row=float(row)) for ball, (column, row) in zip(balls, moved, strict=True)
    )


def _following(errors: Float64Array) -> MaskArray:
    """False for balls whose error stands out (hair, lift-off, a label from another frame) or that show no pixel."""
    median = float(np.nanmedian(errors))
    deviation = float(np.nanmedian(np.abs(errors - median)))
    return np.asarray(errors <= median + STANDS_OUT * max(deviation, LEAST_DEVIATION * median))


def _bands(error_deg: Float64Array, slope: Float64Array) -> tuple[SlopeBand, ...]:
    tilt = np.degrees(np.arctan(np.linalg.norm(slope, axis=1)))
    bands = []
    for low, high in pairwise(BAND_EDGES_DEG):
        inside = (tilt >= low) & (tilt < high)
        if inside.any():
            bands.append(SlopeBand(low, high, float(error_deg[inside].mean()), int(inside.sum())))
    return tuple(bands)
