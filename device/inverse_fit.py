"""Fits the inverse map to balls, judged by balls that the fit did not see.

Each polynomial of the map gets the penalty and the degree in position with the least error on held-out balls (whole
balls, five folds), and a share in the mean that falls steeply with that error. Ball centres come from images and are
off by a pixel or so; each is moved to where the maps learned from the *other* balls put it. Moving centres to fit a
model of the same ball would only shrink the residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from device.ball import Ball, BallSamples
from device.colour_domain import ColourDomain
from device.colour_space import CURVES, ColourSpace, Curve
from device.errors import CalibrationError
from device.held_out_ridge import HeldOutRidge, angle_between_deg, robust_weight
from device.inverse_map import InverseMap, PolynomialMap, design_matrix
from device.polynomials import field_position, joint_terms
from device.stereographic import slope_from_stereographic
from device.surface import Float64Array, MaskArray

COLOUR_DEGREE: Final = 4
POSITION_DEGREES: Final = (0, 1, 2)
PENALTIES: Final = tuple(float(value) for value in 10.0 ** np.arange(-8.0, 1.0, 0.5))
REFINEMENT_ROUNDS: Final = 4
SHIFT_TAKEN: Final = 0.8
"""Share of a centre's indicated shift that is taken."""
FLAT_SHARE: Final = 0.02
"""Untouched skin, as a share of the ball pixels: it pins intensity 1 to slope 0 everywhere in the field."""
LONE_BALL_PENALTY: Final = 1e-3
SHARE_POWER: Final = 20
"""A member's share in the mean falls with this power of its held-out error."""
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
) -> InverseFit:
    """The inverse map of a full-size field of `shape` (H, W) from samples of `balls`, with its held-out errors.

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
    domain = ColourDomain.observed(samples.intensity)
    everyone = np.ones(len(balls), bool)
    if len(balls) == 1:
        slope = _true_slopes(chosen, balls)
        learners = [_learner(chosen, curve, shape, 0, LONE_BALL_PENALTY) for curve in CURVES]
        members = _members(learners, slope, np.ones(len(slope)), everyone)
        fitted = InverseMap(shape, members, domain, balls[0].steepest)
        return InverseFit(fitted, tuple(balls), everyone, np.array([np.nan]), None, ())
    learners = _with_shares([_preferred(chosen, balls, curve, shape) for curve in CURVES])
    state = _refine(chosen, balls, learners)
    rows = state.kept[chosen.ball]
    error = angle_between_deg(state.held_out[rows], state.slope[rows])
    members = _members(learners, state.slope, state.weight, state.kept)
    steepest = max(ball.steepest for ball, follows in zip(balls, state.kept, strict=True) if follows)
    return InverseFit(
        map=InverseMap(shape, members, domain, steepest),
        balls=state.balls,
        kept=state.kept,
        ball_error_deg=state.errors_deg,
        held_out_deg=float(error.mean()),
        bands=_bands(error, state.slope[rows]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Learner:
    """One polynomial that is to be learned: its features, its degree in position, its penalty, its share."""

    colours: ColourSpace
    degree: int
    penalty: float
    ridge: HeldOutRidge
    error: float
    share: float


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


def _learner(samples: BallSamples, curve: Curve, shape: tuple[int, int], degree: int, penalty: float) -> _Learner:
    colours = ColourSpace.observed(samples.intensity, curve)
    place = field_position(samples.column.astype(np.float64), samples.row.astype(np.float64), shape)
    design = design_matrix(colours, COLOUR_DEGREE, degree, samples.intensity, place)
    count = max(int(FLAT_SHARE * len(samples.p)), 1)
    anywhere = np.random.default_rng(1).uniform(-1.0, 1.0, (count, 2))
    flat = design_matrix(colours, COLOUR_DEGREE, degree, np.ones((count, 3), np.float32), anywhere)
    return _Learner(colours, degree, penalty, HeldOutRidge(design, flat.T @ flat, samples.ball), 0.0, 1.0 / len(CURVES))


def _preferred(samples: BallSamples, balls: Sequence[Ball], curve: Curve, shape: tuple[int, int]) -> _Learner:
    """The learner along one curve with the degree in position and the penalty of least held-out error."""
    everyone, weight = np.ones(len(balls), bool), np.ones(len(samples.p))
    slope = _true_slopes(samples, balls)
    best: _Learner | None = None
    for degree in POSITION_DEGREES:
        learner = _learner(samples, curve, shape, degree, 0.0)
        for penalty, u in zip(PENALTIES, learner.ridge.held_out(PENALTIES, slope, weight, everyone), strict=True):
            error = _balanced_error(samples, slope_from_stereographic(u), slope)
            if best is None or error < best.error:
                best = replace(learner, penalty=penalty, error=error)
    assert best is not None  # noqa: S101 - POSITION_DEGREES is not empty
    return best


def _with_shares(learners: Sequence[_Learner]) -> list[_Learner]:
    """The learners with shares that sum to 1."""
    errors = np.array([learner.error for learner in learners])
    shares = (errors.min() / errors) ** SHARE_POWER
    shares /= shares.sum()
    return [replace(learner, share=float(share)) for learner, share in zip(learners, shares, strict=True)]


def _members(
    learners: Sequence[_Learner], slope: Float64Array, weight: Float64Array, kept: MaskArray
) -> tuple[PolynomialMap, ...]:
    """The polynomials learned from the kept balls."""
    members = []
    for learner in learners:
        solution = learner.ridge.solve(learner.penalty, slope, weight, kept)
        terms = joint_terms(COLOUR_DEGREE, learner.degree)
        coefficients = np.zeros((*terms.shape, 2), np.float32)
        coefficients[terms] = solution
        members.append(PolynomialMap(learner.colours, COLOUR_DEGREE, learner.degree, coefficients, learner.share))
    return tuple(members)


def _balanced_error(samples: BallSamples, slope: Float64Array, truth: Float64Array) -> float:
    """Mean absolute slope error after each ball's own median is taken out, so that centre errors do not count."""
    error = slope - truth
    for ball in np.unique(samples.ball):
        rows = samples.ball == ball
        error[rows] -= np.median(error[rows], axis=0)
    return float(np.abs(error).mean())


def _refine(samples: BallSamples, balls: Sequence[Ball], learners: Sequence[_Learner]) -> _Refined:
    """Centres moved, balls that do not follow the sphere dropped, samples weighted: a few rounds of each."""
    slope = _true_slopes(samples, balls)
    count = len(balls)
    state = _Refined(
        tuple(balls), slope, np.ones(len(slope)), np.ones(count, bool), np.full(count, np.nan), np.zeros_like(slope)
    )
    for _ in range(REFINEMENT_ROUNDS):
        held_out = _held_out(learners, state)
        state.balls = _recentred(samples, balls, held_out, state.kept)
        state.slope = _true_slopes(samples, state.balls)
        state.weight = robust_weight(held_out, state.slope)
        angle = angle_between_deg(held_out, state.slope)
        state.errors_deg = np.array([angle[samples.ball == number].mean() for number in range(count)])
        state.kept = _following(state.errors_deg)
    state.held_out = _held_out(learners, state)
    return state


def _held_out(learners: Sequence[_Learner], state: _Refined) -> Float64Array:
    """Slopes of shape (N, 2) that the mean of the learners gives each ball without having seen it."""
    u = np.zeros_like(state.slope)
    for learner in learners:
        u += learner.share * learner.ridge.held_out([learner.penalty], state.slope, state.weight, state.kept)[0]
    return slope_from_stereographic(u)


def _recentred(samples: BallSamples, balls: Sequence[Ball], slope: Float64Array, kept: MaskArray) -> tuple[Ball, ...]:
    """Balls moved towards where held-out slopes put their centres; the set's common shift is left out."""
    radius = np.array([ball.radius_px for ball in balls])[samples.ball]
    towards_apex = slope * (radius / np.sqrt(1.0 + (slope**2).sum(axis=-1)))[:, None]
    apex = np.stack([samples.column, samples.row], axis=-1) + towards_apex
    centre = np.array([[ball.column, ball.row] for ball in balls])
    shift = np.array([np.median(apex[samples.ball == number], axis=0) for number in range(len(balls))]) - centre
    shift = SHIFT_TAKEN * (shift - np.median(shift[kept], axis=0))
    moved = centre + shift
    return tuple(
        replace(ball, column=float(column), row=float(row)) for ball, (column, row) in zip(balls, moved, strict=True)
    )


def _following(errors: Float64Array) -> MaskArray:
    """False for balls whose error stands out: hair, lift-off, a label from another frame."""
    median = float(np.median(errors))
    deviation = float(np.median(np.abs(errors - median)))
    return np.asarray(errors <= median + 3.0 * max(deviation, 0.1 * median))


def _bands(error_deg: Float64Array, slope: Float64Array) -> tuple[SlopeBand, ...]:
    tilt = np.degrees(np.arctan(np.linalg.norm(slope, axis=1)))
    bands = []
    for low, high in pairwise(BAND_EDGES_DEG):
        inside = (tilt >= low) & (tilt < high)
        if inside.any():
            bands.append(SlopeBand(low, high, float(error_deg[inside].mean()), int(inside.sum())))
    return tuple(bands)
