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
from device.errors import CalibrationError
from device.held_out_ridge import HeldOutRidge, angle_between_deg, robust_weight
from device.inverse_map import ColourSpace, InverseMap, design_matrix, position_exponents
from device.surface import Float64Array, MaskArray

COLOUR_DEGREE: Final = 4
POSITION_DEGREES: Final = (0, 1, 2)
PENALTIES: Final = tuple(float(value) for value in 10.0 ** np.arange(-8.0, 1.0, 0.5))
REFINEMENT_ROUNDS: Final = 4
SHIFT_TAKEN: Final = 0.8
"""Share of a centre's indicated shift that is taken."""
FLAT_SHARE: Final = 0.1
"""Untouched skin, as a share of the ball pixels: it pins intensity 1 to slope 0 everywhere in the field."""
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
    colours = ColourSpace.observed(chosen.intensity)
    everyone = np.ones(len(balls), bool)
    if len(balls) == 1:
        ridge = _ridge(chosen, balls, colours, shape, degree=0)
        fitted = _map(ridge, 1e-3, everyone, colours, shape, 0, balls)
        return InverseFit(fitted, tuple(balls), everyone, np.array([np.nan]), None, ())
    degree, penalty, ridge = _preferred(chosen, balls, colours, shape)
    refined, errors, kept = _refine(chosen, balls, ridge, penalty)
    (slope,) = ridge.held_out_slopes([penalty], kept)
    rows = kept[chosen.ball]
    error = angle_between_deg(slope[rows], ridge.slope[rows])
    fitted = _map(ridge, penalty, kept, colours, shape, degree, refined)
    return InverseFit(fitted, refined, kept, errors, float(error.mean()), _bands(error, ridge.slope[rows]))


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


def _ridge(
    samples: BallSamples, balls: Sequence[Ball], colours: ColourSpace, shape: tuple[int, int], degree: int
) -> HeldOutRidge:
    design = design_matrix(colours, COLOUR_DEGREE, degree, shape, samples.intensity, samples.column, samples.row)
    count = max(int(FLAT_SHARE * len(samples.p)), 1)
    place = np.random.default_rng(1).uniform(size=(2, count)).astype(np.float32)
    untouched = np.ones((count, 3), np.float32)
    flat = design_matrix(colours, COLOUR_DEGREE, degree, shape, untouched, place[0] * shape[1], place[1] * shape[0])
    return HeldOutRidge(design, flat.T @ flat, _true_slopes(samples, balls), np.ones(len(samples.p)), samples.ball)


def _preferred(
    samples: BallSamples, balls: Sequence[Ball], colours: ColourSpace, shape: tuple[int, int]
) -> tuple[int, float, HeldOutRidge]:
    """Degree in position, penalty and problem with the least held-out error."""
    everyone = np.ones(len(balls), bool)
    best: tuple[float, int, float, HeldOutRidge] | None = None
    for degree in POSITION_DEGREES:
        ridge = _ridge(samples, balls, colours, shape, degree)
        for penalty, slope in zip(PENALTIES, ridge.held_out_slopes(PENALTIES, everyone), strict=True):
            error = _balanced_error(samples, slope, ridge.slope)
            if best is None or error < best[0]:
                best = (error, degree, penalty, ridge)
    assert best is not None  # noqa: S101 - POSITION_DEGREES is not empty
    return best[1:]


def _balanced_error(samples: BallSamples, slope: Float64Array, truth: Float64Array) -> float:
    """Mean absolute slope error after each ball's own median is taken out, so that centre errors do not count."""
    error = slope - truth
    for ball in np.unique(samples.ball):
        rows = samples.ball == ball
        error[rows] -= np.median(error[rows], axis=0)
    return float(np.abs(error).mean())


def _refine(
    samples: BallSamples, balls: Sequence[Ball], ridge: HeldOutRidge, penalty: float
) -> tuple[tuple[Ball, ...], Float64Array, MaskArray]:
    """Balls with moved centres, their held-out errors, and which follow the sphere; `ridge` takes the slopes."""
    kept = np.ones(len(balls), bool)
    refined: tuple[Ball, ...] = tuple(balls)
    errors = np.full(len(balls), np.nan)
    for _ in range(REFINEMENT_ROUNDS):
        (slope,) = ridge.held_out_slopes([penalty], kept)
        refined = _recentred(samples, balls, slope, kept)
        ridge.slope = _true_slopes(samples, refined)
        ridge.weight = robust_weight(slope, ridge.slope)
        angle = angle_between_deg(slope, ridge.slope)
        errors = np.array([angle[samples.ball == number].mean() for number in range(len(balls))])
        kept = _following(errors)
    return refined, errors, kept


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


def _map(
    ridge: HeldOutRidge,
    penalty: float,
    kept: MaskArray,
    colours: ColourSpace,
    shape: tuple[int, int],
    degree: int,
    balls: Sequence[Ball],
) -> InverseMap:
    coefficients = ridge.solve(penalty, kept).reshape(-1, len(position_exponents(degree)), 2).astype(np.float32)
    steepest = max(ball.steepest for ball, follows in zip(balls, kept, strict=True) if follows)
    return InverseMap(shape, colours, COLOUR_DEGREE, degree, coefficients, steepest)


def _bands(error_deg: Float64Array, slope: Float64Array) -> tuple[SlopeBand, ...]:
    tilt = np.degrees(np.arctan(np.linalg.norm(slope, axis=1)))
    bands = []
    for low, high in pairwise(BAND_EDGES_DEG):
        inside = (tilt >= low) & (tilt < high)
        if inside.any():
            bands.append(SlopeBand(low, high, float(error_deg[inside].mean()), int(inside.sum())))
    return tuple(bands)
