"""Balls' centres refined round by round, with the balls that stand out left aside and samples weighed.

Ball centres come from images and are off by a pixel or so; each is moved to where the map learned from the *other*
balls puts it. Moving centres to fit a model of the same ball would only shrink the residual.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import Ball, BallSamples
from device.calibration.candidates import RegressorFit
from device.calibration.cross_validation import angle_between_deg, robust_weight
from device.surface import Float64Array, MaskArray, slope_from_stereographic

REFINEMENT_ROUNDS: Final = 4
SHIFT_TAKEN: Final = 0.8
"""Share of a centre's indicated shift that is taken."""
RUNAWAY: Final = 1.1
"""Times the least held-out error so far that a round may bring."""

STANDS_OUT: Final = 3.0
"""Deviations from the median error from which a ball is no longer used for training."""

MIN_DEVIATION: Final = 0.15
"""The deviation counts as this share of the median at least: a ball alone in a corner is predicted worse."""

FEW_BALLS: Final = 20
FEW_DEVIATION: Final = 0.5
"""The same among fewer balls, each of which leaves a hole in the field when it is held out: of four by three the outer
ones are predicted twice as badly by the inner ones, and without them the map is not trained at the border."""

OPEN_SIDE: Final = 0.75 * np.pi
"""A ball with no other in such a sector around it, in radians, is an outer one: when it is held out, it is read by a
map that saw nothing as far out. A tilted grid presses its balls less deep at one edge, so that only balls pressed one
at a time are given this margin."""

Learners = Sequence[tuple[RegressorFit, float]]
"""The learners of a map with their shares."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Balls with moved centres, true slopes and weights of the samples that follow from them, held-out slopes."""

    balls: tuple[Ball, ...]
    slope: Float64Array
    weight: Float64Array
    kept: MaskArray
    errors_deg: Float64Array
    held_out: Float64Array


def refine(samples: BallSamples, balls: Sequence[Ball], learners: Learners, alone: MaskArray | None = None) -> Refined:
    """Return centres moved, balls that do not follow the sphere dropped, samples weighted: a few rounds of each.

    Few balls leave room for a map that fits shifted centres as well as true ones; each round then moves them farther.
    Rounds that make held-out balls worse by `RUNAWAY` are taken back.

    alone : bool array of shape (balls,), True for the only ball of its press; None where that is not known
    """
    slope = true_slopes(samples, balls)
    count = len(balls)
    seen = np.bincount(samples.ball, minlength=count) > 0
    state = Refined(tuple(balls), slope, np.ones(len(slope)), seen, np.full(count, np.nan), np.zeros_like(slope))
    state = replace(state, held_out=held_out_slopes(learners, state))
    best, least = state, _typical_error_deg(samples, state)
    alone = np.zeros(count, np.bool_) if alone is None else alone
    for _ in range(REFINEMENT_ROUNDS):
        state = _refined_once(samples, state, learners, seen, alone)
        error = _typical_error_deg(samples, state)
        if error > RUNAWAY * least:
            break
        if error < least:
            best, least = state, error
    else:
        return state
    if np.isnan(best.errors_deg).all():
        errors = _errors_deg(samples, best.held_out, best.slope, seen)
        best = replace(best, errors_deg=errors, kept=_following(errors, alone & _outer(best.balls)))
    return best


def _refined_once(
    samples: BallSamples, before: Refined, learners: Learners, seen: MaskArray, alone: MaskArray
) -> Refined:
    """Return the state after one round, with the slopes that it holds out."""
    balls = _recentred(samples, before.balls, before.held_out, before.kept)
    slope = true_slopes(samples, balls)
    errors = _errors_deg(samples, before.held_out, slope, seen)
    kept = _following(errors, alone & _outer(balls))
    state = Refined(balls, slope, robust_weight(before.held_out, slope), kept, errors, before.held_out)
    return replace(state, held_out=held_out_slopes(learners, state))


def _errors_deg(samples: BallSamples, read: Float64Array, slope: Float64Array, seen: MaskArray) -> Float64Array:
    """Return each ball's mean angle between slopes (N, 2) as read and true ones: (balls,), NaN if not `seen`."""
    angle = angle_between_deg(read, slope)
    pixels = np.maximum(np.bincount(samples.ball, minlength=len(seen)), 1)
    return np.asarray(np.where(seen, np.bincount(samples.ball, angle, len(seen)) / pixels, np.nan))


def _typical_error_deg(samples: BallSamples, state: Refined) -> float:
    """Return the median over balls of the held-out error at a state's own centres."""
    seen = np.bincount(samples.ball, minlength=len(state.balls)) > 0
    return float(np.nanmedian(_errors_deg(samples, state.held_out, state.slope, seen)))


def held_out_slopes(learners: Learners, state: Refined, fold_of_ball: NDArray[np.intp] | None = None) -> Float64Array:
    """Return slopes (N, 2) that the learners together give each ball without having seen it; folds as the ridge's."""
    u = np.zeros_like(state.slope)
    arguments = state.slope, state.weight, state.kept, fold_of_ball
    calls = [partial(learner.ridge.held_out, [learner.penalty], *arguments) for learner, _ in learners]
    for (_, share), (own,) in zip(learners, results_of(calls), strict=True):
        u += share * own
    return slope_from_stereographic(u)


def true_slopes(samples: BallSamples, balls: Sequence[Ball]) -> Float64Array:
    """Return slopes of shape (N, 2) of the spheres at their present centres."""
    radius = np.array([ball.radius_px for ball in balls])[samples.ball]
    offset = _offsets(samples, balls)
    height = np.sqrt(np.maximum(radius**2 - (offset**2).sum(axis=-1), (0.2 * radius) ** 2))
    return np.asarray(-offset / height[:, None])


def _offsets(samples: BallSamples, balls: Sequence[Ball]) -> Float64Array:
    """Return how far to the right of and below their spheres' axes the samples see them, pixels: shape (N, 2)."""
    centre = np.array([[ball.column, ball.row] for ball in balls])[samples.ball]
    pixel = np.stack([samples.column, samples.row], axis=-1).astype(np.float64)
    viewpoint = balls[0].viewpoint
    if viewpoint is None:
        return np.asarray(pixel - centre)
    radius, apex = (
        np.array(part)[samples.ball] for part in zip(*((b.radius_px, b.apex_px) for b in balls), strict=True)
    )
    return viewpoint.offsets_from_axis(pixel.T, centre.T, radius, apex).T


def _recentred(samples: BallSamples, balls: Sequence[Ball], slope: Float64Array, kept: MaskArray) -> tuple[Ball, ...]:
    """Return balls moved towards where held-out slopes put their centres; the set's common shift is left out."""
    radius = np.array([ball.radius_px for ball in balls])[samples.ball]
    towards_apex = slope * (radius / np.sqrt(1.0 + (slope**2).sum(axis=-1)))[:, None]
    off = _offsets(samples, balls) + towards_apex
    centre = np.array([[ball.column, ball.row] for ball in balls])
    shift = np.zeros_like(centre)
    for number in np.unique(samples.ball):
        shift[number] = np.median(off[samples.ball == number], axis=0) * balls[number].seen_larger
    shift = SHIFT_TAKEN * (shift - np.median(shift[kept], axis=0))
    moved = centre + shift
    return tuple(
        replace(ball, column=float(column), row=float(row)) for ball, (column, row) in zip(balls, moved, strict=True)
    )


def _following(errors: Float64Array, far_out: MaskArray) -> MaskArray:
    """Return False for balls whose error stands out (hair, lift-off, a label from another frame) or that show no pixel.

    far_out : bool array of shape (balls,), True for balls whose error may stand out as far as that of one of few balls
    """
    median = float(np.nanmedian(errors))
    deviation = float(np.nanmedian(np.abs(errors - median)))
    few = np.isfinite(errors).sum() < FEW_BALLS
    least = FEW_DEVIATION if few else np.where(far_out, FEW_DEVIATION, MIN_DEVIATION)
    return np.asarray(errors <= median + STANDS_OUT * np.maximum(deviation, least * median))


def _outer(balls: Sequence[Ball]) -> MaskArray:
    """Return True for balls that have a side without another ball: bool array of shape (balls,)."""
    centre = np.array([[ball.column, ball.row] for ball in balls])
    open_side = np.zeros(len(balls), np.bool_)
    for number, at in enumerate(centre):
        way = np.delete(centre, number, axis=0) - at
        angle = np.sort(np.arctan2(way[:, 1], way[:, 0]))
        open_side[number] = np.diff(np.append(angle, angle[0] + 2.0 * np.pi)).max() >= OPEN_SIDE
    return open_side


# Calls that do not depend on each other, on all cores: numpy works outside the interpreter's lock.

Result = TypeVar("Result")


def results_of(calls: Iterable[Callable[[], Result]]) -> list[Result]:
    """Return results in the calls' order, whichever ends first."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return [job.result() for job in [pool.submit(call) for call in calls]]
