"""What each channel of a frame shows of a slope: the forward model that tells where a light does not reach the skin.

A matt skin of slope g at the place (x, y) shows, divided by its reference and times √(1 + |g|²), 1 + a(x, y)·g with a
the slant of the channel's light. What skins that are not matt add bends with the slope and little with place. The
inverse map reads slopes better than any inversion of this model, but only where all three lights arrive; a model of
each channel by itself says what the others would read where one does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.polynomial_features import field_position, monomials, position_exponents
from device.surface.fields import Float64Array

SLANT_DEGREE: Final = 3
BEND_DEGREE: Final = 1
"""Degrees in position of the lights' slants, and of what bends with slope."""

LIT: Final = 0.12
"""Intensity above which a light reaches a ball's skin: others tell nothing of how it shines."""

MAX_SAMPLES: Final = 40_000
MIN_SAMPLES: Final = 1000
ROUNDS: Final = 3
OUTLIER: Final = 4.0
"""Samples off by so many standard deviations are left out of the next round's fit."""

RIDGE: Final = 1e-6
MAX_RESIDUAL: Final = 0.04
"""Root mean square intensity that a model may leave of the balls; a larger one says too little of single channels.

With 0.12 the twin's coat of sharp flakes gains (its balls 130 -> 110 µm rms too high), but a rendered bench under near
lights goes from 5.5 to 10.9 µm, and real sets lose: finger 2.8° -> 3.9°, taxim-small 2.4° -> 3.1°.
"""

GLITTERING: Final = 0.07
"""Residual from which skin is not matt at all: 0.04 under near lights, 0.10 on the twin's sharp flakes."""

LEAK_PATCH: Final = 5
LEAK_STEP: Final = 4
"""Leaks are read from means over patches of so many pixels, every so many pixels ..."""

LEAK_REACH: Final = 2.0
"""... up to so many contact radii from a ball's centre ..."""

DARKEST: Final = 0.005
"""... as this quantile of a channel's ratio to the others."""

TERMS: Final = 10
"""Values of a channel's polynomial in slope at one place; see `slope_terms`."""


@dataclass(frozen=True, slots=True, eq=False)
class ShadingModel:
    """The forward model of three channels.

    slants : float64 array of shape (3, K, 2), by channel and position monomial, a's components
    bends : float64 array of shape (3, L, 8), the same of the other terms of `slope_terms`
    leaks : float64 array of shape (3,), share of the other channels' lights that a channel sees
    residual : root mean square intensity that it leaves of the balls that it was fitted to
    """

    slants: Float64Array
    bends: Float64Array
    leaks: Float64Array
    residual: float

    def at(self, place: Float64Array) -> Float64Array:
        """Coefficients of `slope_terms` at position variables (N, 2): shape (N, 3, TERMS)."""
        slants = np.einsum("nk,ckd->ncd", monomials(place, SLANT_DEGREE), self.slants)
        bends = np.einsum("nl,cld->ncd", monomials(place, BEND_DEGREE), self.bends)
        return np.concatenate([slants, bends], axis=-1)


def slope_terms(p: Float64Array, q: Float64Array) -> Float64Array:
    """p, q, p², p q, q², p |g|², q |g|², |g|⁴, p |g|⁴, q |g|⁴ of slopes (N,): shape (N, TERMS)."""
    square = p * p + q * q
    return np.stack([p, q, p * p, p * q, q * q, p * square, q * square, square**2, p * square**2, q * square**2], -1)


def fit_shading_model(
    samples: BallSamples,
    presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]],
    max_residual: float = MAX_RESIDUAL,
) -> ShadingModel | None:
    """The model of samples of the balls of presses; None where they do not tell one well enough.

    max_residual : of the model's intensity that is well enough
    """
    shape = presses[0][0].shape
    chosen = np.arange(len(samples.p))
    if len(chosen) > MAX_SAMPLES:
        chosen = np.random.default_rng(0).permutation(chosen)[:MAX_SAMPLES]
    p, q = (slope[chosen].astype(np.float64) for slope in (samples.p, samples.q))
    place = field_position(samples.column[chosen].astype(np.float64), samples.row[chosen].astype(np.float64), shape)
    terms = slope_terms(p, q)
    slant, bend = (
        (monomials(place, degree)[:, :, None] * part[:, None, :]).reshape(len(p), -1)
        for degree, part in ((SLANT_DEGREE, terms[:, :2]), (BEND_DEGREE, terms[:, 2:]))
    )
    design = np.concatenate([slant, bend], axis=1)
    steepness = np.sqrt(1.0 + p * p + q * q)
    found, squares, count = [], 0.0, 0
    for channel in range(3):
        intensity = samples.intensity[chosen, channel].astype(np.float64)
        lit = intensity > LIT
        if lit.sum() < MIN_SAMPLES:
            return None
        rows, wanted = design[lit], intensity[lit] * steepness[lit] - 1.0
        for _ in range(ROUNDS):
            gram = rows.T @ rows + RIDGE * len(rows) * np.eye(rows.shape[1])
            coefficients = np.linalg.solve(gram, rows.T @ wanted)
            left = wanted - rows @ coefficients
            inside = np.abs(left) < OUTLIER * np.std(left)
            rows, wanted, left = rows[inside], wanted[inside], left[inside]
        found.append(coefficients)
        squares, count = squares + float((left**2).sum()), count + len(left)
    residual = float(np.sqrt(squares / count))
    if residual > max_residual:
        return None
    split = 2 * len(position_exponents(SLANT_DEGREE))
    by_channel = np.stack(found)
    slants, bends = by_channel[:, :split].reshape(3, -1, 2), by_channel[:, split:].reshape(3, -1, TERMS - 2)
    return ShadingModel(slants, bends, measure_leaks(presses), residual)


def measure_leaks(presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]]) -> Float64Array:
    """What a channel sees, at its darkest around balls, of the other two: ratios to their sum, shape (3,).

    There its own light is hidden or has set, so that the rest is light of the others that its filter passes. A press
    whose balls hide no light shows more; a quarter of the presses need to hide each.
    """
    darkest = []
    for image, balls in presses:
        small = cv2.blur(image.values, (LEAK_PATCH, LEAK_PATCH))[
            LEAK_PATCH // 2 :: LEAK_STEP, LEAK_PATCH // 2 :: LEAK_STEP
        ]
        row, column = (np.arange(count) * LEAK_STEP + LEAK_PATCH // 2 for count in small.shape[:2])
        near = np.zeros(small.shape[:2], np.bool_)
        for ball in balls:
            distance = np.hypot(column[None, :] - ball.column, row[:, None] - ball.row)
            near |= distance < LEAK_REACH * ball.contact_radius_px
        seen = small[near].astype(np.float64)
        if len(seen):
            others = np.maximum(seen.sum(axis=1, keepdims=True) - seen, 1e-3)
            darkest.append(np.quantile(seen / others, DARKEST, axis=0))
    return np.asarray(np.quantile(darkest, 0.25, axis=0))


def intensity_and_slope_change(
    coefficients: Float64Array, p: Float64Array, q: Float64Array, raised: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Intensity (N, 3) of slopes (N,), and what it changes with p and q, shape (N, 3, 2).

    coefficients : of `ShadingModel.at`
    raised : shape (N, 3, 3), what elevation adds to the light: a constant and factors of p and q
    """
    square = p * p + q * q
    steepness = np.sqrt(1.0 + square)
    light = 1.0 + np.einsum("nct,nt->nc", coefficients, slope_terms(p, q))
    light += raised[..., 0] + raised[..., 1] * p[:, None] + raised[..., 2] * q[:, None]
    change = np.matmul(coefficients, _term_changes(p, q)) + raised[..., 1:]
    lit = light > 0.0
    intensity = np.where(lit, light, 0.0) / steepness[:, None]
    slope = np.stack([p, q], axis=-1)[:, None, :]
    by_slope = change / steepness[:, None, None] - (light / steepness[:, None] ** 3)[..., None] * slope
    return intensity, np.where(lit[..., None], by_slope, 0.0)


def _term_changes(p: Float64Array, q: Float64Array) -> Float64Array:
    """Derivatives of `slope_terms` by p and q: shape (N, TERMS, 2)."""
    zero, one = np.zeros_like(p), np.ones_like(p)
    square = p * p + q * q
    by_p = [one, zero, 2 * p, q, zero, square + 2 * p * p, 2 * p * q, 4 * p * square]
    by_q = [zero, one, zero, p, 2 * q, 2 * p * q, square + 2 * q * q, 4 * q * square]
    by_p += [square**2 + 4 * p * p * square, 4 * p * q * square]
    by_q += [4 * p * q * square, square**2 + 4 * q * q * square]
    return np.stack([np.stack(by_p, axis=-1), np.stack(by_q, axis=-1)], axis=-1)
