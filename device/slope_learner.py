"""The inverse map's polynomial while it is being learned: its features, its degree in position, its penalty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.ball import BallSamples
from device.colour_space import ColourSpace
from device.held_out_ridge import HeldOutRidge
from device.inverse_map import design_matrix
from device.polynomials import field_position
from device.stereographic import slope_from_stereographic
from device.surface import Float64Array

COLOUR_DEGREE: Final = 4
POSITION_DEGREES: Final = (0, 1, 2)
PENALTIES: Final = tuple(float(value) for value in 10.0 ** np.arange(-8.0, 1.0, 0.5))
FLAT_SHARE: Final = 0.1
"""Untouched skin, as a share of the ball pixels: it pins intensity 1 to slope 0 everywhere in the field."""


@dataclass(frozen=True, slots=True, eq=False)
class SlopeLearner:
    """A polynomial that is to be learned.

    colours : the variables that it is a polynomial in
    degree : its degree in position
    penalty : of the ridge
    ridge : its features at the pixels of balls
    error : mean absolute slope error on held-out balls, whose centres do not count
    """

    colours: ColourSpace
    degree: int
    penalty: float
    ridge: HeldOutRidge
    error: float


def learner_of(samples: BallSamples, shape: tuple[int, int], degree: int, penalty: float) -> SlopeLearner:
    """The learner with this degree in position and this penalty, for a full-size field of `shape` (H, W)."""
    colours = ColourSpace.observed(samples.intensity)
    place = field_position(samples.column.astype(np.float64), samples.row.astype(np.float64), shape)
    design = design_matrix(colours, COLOUR_DEGREE, degree, samples.intensity, place)
    count = max(int(FLAT_SHARE * len(samples.p)), 1)
    anywhere = np.random.default_rng(1).uniform(-1.0, 1.0, (count, 2))
    flat = design_matrix(colours, COLOUR_DEGREE, degree, np.ones((count, 3), np.float32), anywhere)
    return SlopeLearner(colours, degree, penalty, HeldOutRidge(design, flat.T @ flat, samples.ball), 0.0)


def preferred_learner(samples: BallSamples, slope: Float64Array, count: int, shape: tuple[int, int]) -> SlopeLearner:
    """The learner with the degree in position and the penalty of least held-out error.

    slope : float64 array of shape (N, 2), true slopes of the samples
    count : of balls
    """
    everyone, weight = np.ones(count, bool), np.ones(len(samples.p))
    best: SlopeLearner | None = None
    for degree in POSITION_DEGREES:
        learner = learner_of(samples, shape, degree, 0.0)
        for penalty, u in zip(PENALTIES, learner.ridge.held_out(PENALTIES, slope, weight, everyone), strict=True):
            error = _balanced_error(samples, slope_from_stereographic(u), slope)
            if best is None or error < best.error:
                best = replace(learner, penalty=penalty, error=error)
    assert best is not None  # noqa: S101 - POSITION_DEGREES is not empty
    return best


def _balanced_error(samples: BallSamples, slope: Float64Array, truth: Float64Array) -> float:
    """Mean absolute slope error after each ball's own median is taken out, so that centre errors do not count."""
    error = slope - truth
    for ball in np.unique(samples.ball):
        rows = samples.ball == ball
        error[rows] -= np.median(error[rows], axis=0)
    return float(np.abs(error).mean())
