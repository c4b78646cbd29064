"""Intensity of gentle slopes anywhere in the field, estimated from the balls.

A matt skin of slope g shows, divided by its reference, I √(1 + |g|²) = 1 + a·g, where a is the light's direction;
real coats add squares and cubes of g. All of them are polynomials in position under a point over a plane. Where the
reference is dark for another reason than that lights stand low, they change with it, and each of them times the
reference's light is a polynomial instead: held-out balls decide.

Balls show slopes of a few degrees on a hundredth of their area, and nothing between them. What this predicts there
anchors the curves of the inverse map (see `device.calibration.candidates`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import BallSamples
from device.inverse_map.near_light import (
    CUBIC_PENALTY,
    GENTLE,
    OLD_PLACE_DEGREE,
    PLACE_DEGREE,
    IlluminationMap,
    direction_features,
    lit_by,
)
from device.inverse_map.regressor import field_position, monomials, position_exponents
from device.surface import Float32Array, Float64Array, MaskArray

BEND_DEGREE: Final = 1
"""Degree in position of what squares and cubes of slopes do.

Where that is held alike all over the field, directions of rendered sensors are 1.5 to 6 % off; with this 0.7 to 5 %. Of
degree 2 a dozen balls determine no more.
"""

MIN_LIGHT: Final = 0.01
"""Light of untouched skin, relative to its mean over the field, below which nothing is divided by it."""

ONE_SIGMA_PERCENT: Final = 68.27

LIT_GAIN: Final = 0.8
"""Share of the error at balls left out that polynomials times the reference's light must reach to be taken.

It is 0.7 on two rendered sensors with strongly coloured light, and 0.99 to 3 on the others.
"""


@dataclass(frozen=True, slots=True, eq=False)
class GentleSkin:
    """Intensity of gentle slopes by place.

    coefficients : float64 array of shape (F, 3), of `_features`
    noise : float64 array of shape (3,), standard deviation of intensity at the pixels that they were fitted to
    light : what they are divided by, of untouched skin; None where they are not
    """

    coefficients: Float64Array
    noise: Float64Array
    light: IlluminationMap | None = None

    @classmethod
    def of(
        cls, samples: BallSamples, slope: Float64Array, shape: tuple[int, int], light: IlluminationMap | None = None
    ) -> GentleSkin:
        """Return the model of the gentle slopes among slopes (N, 2) of a full-size field of `shape` (H, W).

        Where no slope is gentle every coefficient is zero: slopes show nothing.
        """
        equations = _Equations.of(samples, slope, shape, light)
        known = equations.solution(*equations.normal())
        return cls(known, equations.noise(known), light)

    @classmethod
    def best(
        cls, samples: BallSamples, slope: Float64Array, shape: tuple[int, int], light: IlluminationMap
    ) -> GentleSkin:
        """Return that model, divided by `light` where this predicts held-out balls clearly better."""
        plain, lit = (_Equations.of(samples, slope, shape, over).held_out_error() for over in (None, light))
        return cls.of(samples, slope, shape, light if lit < LIT_GAIN * plain else None)

    def shown(self, slope: Float64Array, place: Float64Array) -> Float32Array:
        """Return intensities (N, 3) of slopes (N, 2) at position variables (N, 2)."""
        lit = _features(slope, place) @ self.coefficients
        if self.light is not None:
            lit /= np.maximum(self.light.at(place), MIN_LIGHT)
        return np.asarray((1.0 + lit) / np.sqrt(1.0 + (slope**2).sum(axis=1, keepdims=True)), np.float32)


def _features(slope: Float64Array, position: Float64Array) -> Float64Array:
    """Return slopes times monomials of position, then squares and cubes of slopes times fewer of them: shape (N, F)."""
    place = monomials(position, BEND_DEGREE)
    p, q = slope.T
    squares = np.concatenate([square[:, None] * place for square in (p * p, p * q, q * q)], axis=1)
    cubes = (slope**2).sum(axis=1, keepdims=True) * direction_features(slope, place)
    linear = direction_features(slope, monomials(position, PLACE_DEGREE))
    return np.concatenate([linear, squares, cubes], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Least squares for what gentle slopes of balls show.

    features : float64 array of shape (N, F)
    lit : float64 array of shape (N, 3), what they add up to
    ball : intp array of shape (N,)
    light : float64 array of shape (N, 3), what `lit` was multiplied by
    price : float64 array of shape (F,), of a coefficient's square
    """

    features: Float64Array
    lit: Float64Array
    ball: NDArray[np.intp]
    light: Float64Array
    price: Float64Array

    @classmethod
    def of(
        cls, samples: BallSamples, slope: Float64Array, shape: tuple[int, int], light: IlluminationMap | None
    ) -> _Equations:
        gentle = np.linalg.norm(slope, axis=1) < GENTLE
        position, ball = field_position(samples.column[gentle], samples.row[gentle], shape), samples.ball[gentle]
        features = _features(slope[gentle], position)
        over = np.ones((len(ball), 3)) if light is None else light.at(position).astype(np.float64)
        information = 0.5 * float((slope[gentle] ** 2).sum()) / max(len(np.unique(ball)), 1)
        dear = np.repeat([float(i + j > OLD_PLACE_DEGREE) for i, j in position_exponents(PLACE_DEGREE)], 2)
        price = np.zeros(features.shape[1])
        price[: len(dear)] = CUBIC_PENALTY**2 * information * dear
        return cls(features, over * lit_by(samples.intensity[gentle], slope[gentle]), ball, over, price)

    def normal(self, rows: MaskArray | slice = slice(None)) -> tuple[Float64Array, Float64Array]:
        """Return the gram matrix (F, F) and moments (F, 3) of these rows."""
        features = self.features[rows]
        return features.T @ features, features.T @ self.lit[rows]

    def solution(self, gram: Float64Array, moment: Float64Array) -> Float64Array:
        """Return coefficients (F, 3); 0 where nothing is known."""
        return np.asarray(np.linalg.lstsq(gram + np.diag(self.price), moment, rcond=None)[0])

    def noise(self, known: Float64Array) -> Float64Array:
        """Return the standard deviation by channel of what the model leaves of intensity; 0 without gentle slopes.

        known : coefficients of the model, shape (F, 3)
        """
        if not len(self.ball):
            return np.zeros(3)
        left = (self.lit - self.features @ known) / np.maximum(self.light, MIN_LIGHT)
        return np.asarray(np.percentile(np.abs(left), ONE_SIGMA_PERCENT, axis=0))

    def held_out_error(self) -> float:
        """Return the root mean square error of intensity at balls that are left out; infinite without gentle slopes."""
        gram, moment = self.normal()
        square, count = 0.0, 0
        for ball in np.unique(self.ball):
            own = self.ball == ball
            own_gram, own_moment = self.normal(own)
            known = self.solution(gram - own_gram, moment - own_moment)
            left = (self.lit[own] - self.features[own] @ known) / np.maximum(self.light[own], MIN_LIGHT)
            square, count = square + float((left**2).sum()), count + left.size
        return float(np.sqrt(square / count)) if count else np.inf
