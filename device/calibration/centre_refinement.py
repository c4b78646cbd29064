"""Balls' centres refined round by round, with the balls that stand out left aside and samples weighed.

Ball centres come from images and are off by a pixel or so; each is moved to where the map learned from the *other*
balls puts it. Moving centres to fit a model of the same ball would only shrink the residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import Ball, BallSamples
from device.calibration.candidates import RegressorFit
from device.calibration.cross_validation import angle_between_deg, robust_weight
from device.surface.fields import Float64Array, MaskArray
from device.surface.stereographic import slope_from_stereographic

REFINEMENT_ROUNDS: Final = 4
SHIFT_TAKEN: Final = 0.8
"""Share of a centre's indicated shift that is taken."""
STANDS_OUT: Final = 3.0
"""Deviations from the median error from which a ball is no longer used for training."""

MIN_DEVIATION: Final = 0.15
"""The deviation counts as this share of the median at least: a ball alone in a corner is predicted worse."""

FEW_BALLS: Final = 8
FEW_DEVIATION: Final = 0.5
"""The same among fewer balls, each of which leaves a hole in the field when it is held out."""

Learners = Sequence[tuple[RegressorFit, float]]
"""The learners of a map with their shares."""


@dataclass(slots=True, eq=False)
class Refined:
    """Balls with moved centres, true slopes and weights of the samples that follow from them, held-out slopes."""

    balls: tuple[Ball, ...]
    slope: Float64Array
    weight: Float64Array
    kept: MaskArray
    errors_deg: Float64Array
    held_out: Float64Array


def refine(samples: BallSamples, balls: Sequence[Ball], learners: Learners) -> Refined:
    """Centres moved, balls that do not follow the sphere dropped, samples weighted: a few rounds of each."""
    slope = true_slopes(samples, balls)
    count = len(balls)
    seen = np.bincount(samples.ball, minlength=count) > 0
    state = Refined(tuple(balls), slope, np.ones(len(slope)), seen, np.full(count, np.nan), np.zeros_like(slope))
    for _ in range(REFINEMENT_ROUNDS):
        held_out = held_out_slopes(learners, state)
        state.balls = _recentred(samples, balls, held_out, state.kept)
        state.slope = true_slopes(samples, state.balls)
        state.weight = robust_weight(held_out, state.slope)
        angle = angle_between_deg(held_out, state.slope)
        pixels = np.maximum(np.bincount(samples.ball, minlength=count), 1)
        state.errors_deg = np.where(seen, np.bincount(samples.ball, angle, count) / pixels, np.nan)
        state.kept = _following(state.errors_deg)
    state.held_out = held_out_slopes(learners, state)
    return state


def held_out_slopes(learners: Learners, state: Refined, fold_of_ball: NDArray[np.intp] | None = None) -> Float64Array:
    """Slopes of shape (N, 2) that the learners together give each ball without having seen it; folds as the ridge's."""
    u = np.zeros_like(state.slope)
    for learner, share in learners:
        (own,) = learner.ridge.held_out([learner.penalty], state.slope, state.weight, state.kept, fold_of_ball)
        u += share * own
    return slope_from_stereographic(u)


def true_slopes(samples: BallSamples, balls: Sequence[Ball]) -> Float64Array:
    """Slopes of shape (N, 2) of the spheres at their present centres."""
    centre = np.array([[ball.column, ball.row] for ball in balls])[samples.ball]
    radius = np.array([ball.radius_px for ball in balls])[samples.ball]
    offset = np.stack([samples.column, samples.row], axis=-1) - centre
    height = np.sqrt(np.maximum(radius**2 - (offset**2).sum(axis=-1), (0.2 * radius) ** 2))
    return np.asarray(-offset / height[:, None])


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
    least = MIN_DEVIATION if np.isfinite(errors).sum() >= FEW_BALLS else FEW_DEVIATION
    return np.asarray(errors <= median + STANDS_OUT * max(deviation, least * median))
