"""One polynomial of the inverse map while it is being learned: its degree, its penalty and its share in the mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.ball import BallSamples
from device.colour_space import CURVES, ColourSpace, Curve
from device.held_out_ridge import HeldOutRidge
from device.inverse_map import PolynomialMap, design_matrix
from device.polynomials import field_position, joint_terms
from device.stereographic import slope_from_stereographic
from device.surface import Float64Array, MaskArray

COLOUR_DEGREE: Final = 4
POSITION_DEGREES: Final = (0, 1, 2)
PENALTIES: Final = tuple(float(value) for value in 10.0 ** np.arange(-8.0, 1.0, 0.5))
FLAT_SHARE: Final = 0.02
"""Untouched skin, as a share of the ball pixels: it pins intensity 1 to slope 0 everywhere in the field."""
SHARE_POWER: Final = 20
"""A polynomial's share in the mean falls with this power of its held-out error."""


@dataclass(frozen=True, slots=True, eq=False)
class SlopeLearner:
    """A polynomial that is to be learned.

    colours : the curve of intensity that it is a polynomial in
    degree : its degree in position
    penalty : of the ridge
    ridge : its features at the pixels of balls
    error : mean absolute slope error on held-out balls, whose centres do not count
    share : its weight in the mean
    """

    colours: ColourSpace
    degree: int
    penalty: float
    ridge: HeldOutRidge
    error: float
    share: float


def learner_of(samples: BallSamples, curve: Curve, shape: tuple[int, int], degree: int, penalty: float) -> SlopeLearner:
    """The learner along one curve with this degree in position and this penalty."""
    colours = ColourSpace.observed(samples.intensity, curve)
    place = field_position(samples.column.astype(np.float64), samples.row.astype(np.float64), shape)
    design = design_matrix(colours, COLOUR_DEGREE, degree, samples.intensity, place)
    count = max(int(FLAT_SHARE * len(samples.p)), 1)
    anywhere = np.random.default_rng(1).uniform(-1.0, 1.0, (count, 2))
    flat = design_matrix(colours, COLOUR_DEGREE, degree, np.ones((count, 3), np.float32), anywhere)
    return SlopeLearner(
        colours, degree, penalty, HeldOutRidge(design, flat.T @ flat, samples.ball), 0.0, 1.0 / len(CURVES)
    )


def preferred_learner(
    samples: BallSamples, slope: Float64Array, count: int, curve: Curve, shape: tuple[int, int]
) -> SlopeLearner:
    """The learner along one curve with the degree in position and the penalty of least held-out error.

    slope : float64 array of shape (N, 2), true slopes of the samples
    count : of balls
    """
    everyone, weight = np.ones(count, bool), np.ones(len(samples.p))
    best: SlopeLearner | None = None
    for degree in POSITION_DEGREES:
        learner = learner_of(samples, curve, shape, degree, 0.0)
        for penalty, u in zip(PENALTIES, learner.ridge.held_out(PENALTIES, slope, weight, everyone), strict=True):
            error = _balanced_error(samples, slope_from_stereographic(u), slope)
            if best is None or error < best.error:
                best = replace(learner, penalty=penalty, error=error)
    assert best is not None  # noqa: S101 - POSITION_DEGREES is not empty
    return best


def with_shares(learners: Sequence[SlopeLearner]) -> list[SlopeLearner]:
    """The learners with shares that sum to 1."""
    errors = np.array([learner.error for learner in learners])
    shares = (errors.min() / errors) ** SHARE_POWER
    shares /= shares.sum()
    return [replace(learner, share=float(share)) for learner, share in zip(learners, shares, strict=True)]


def learned_members(
    learners: Sequence[SlopeLearner], slope: Float64Array, weight: Float64Array, kept: MaskArray
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


def held_out_mean(
    learners: Sequence[SlopeLearner], slope: Float64Array, weight: Float64Array, kept: MaskArray
) -> Float64Array:
    """Slopes of shape (N, 2) that the mean of the learners gives each ball without having seen it."""
    u = np.zeros_like(slope)
    for learner in learners:
        u += learner.share * learner.ridge.held_out([learner.penalty], slope, weight, kept)[0]
    return slope_from_stereographic(u)
