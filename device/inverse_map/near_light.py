"""Lights so near that they stand elsewhere for every place of the field: intensity as the slopes of a matt skin.

A matt skin of slope g shows, divided by its reference, I √(1 + |g|²) = 1 + a·g under one light, and under mixtures of
lights too; a says where the light stands as seen from that place. Three channels then give three linear equations,

    s I_k = 1 + a_k(x, y)·g,        k = R, G, B,

for g and the inverse brightness s. Where skin glitters or a light has set behind it they are wrong, but as variables of
a polynomial they leave it little to do: colour and place are taken apart before it begins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import BallSamples
from device.inverse_map.polynomial_features import field_position, monomials, position_exponents
from device.surface.fields import Float32Array, Float64Array

PLACE_DEGREE: Final = 3
"""Degree in position of the lights' directions: 1 is a point's over a plane; of several lights, in a strip or through a
filter that lets others pass, each is the nearest somewhere, which takes more."""

OLD_PLACE_DEGREE: Final = 2
"""Degree of files written before."""

CUBIC_DOUBT: Final = 0.1
"""Price of terms of degree 3, relative to one ball's information on a direction: a dozen balls leave some open."""

GENTLE: Final = 0.35
"""Slopes up to which samples tell the directions: no light has set behind them."""

MIN_BRIGHTNESS: Final = 0.2
"""1 / s is held above this: beyond it lies no skin that three lights show."""

MIN_VOLUME: Final = 1e-6
"""Of three directions; where they lie in one plane closer than this the equations say nothing."""

VOLUME_SHARE: Final = 0.15
"""The same as a share of the median over the field, and never of the other sign: beyond the outermost balls polynomials
of place may let three directions fall into one plane, where pixel noise was read as slopes of any size."""

VOLUME_PLACES: Final = 9
"""Places along each side of the field at which the median is taken."""

_DEGREES: Final = {len(position_exponents(degree)): degree for degree in (OLD_PLACE_DEGREE, PLACE_DEGREE)}


@dataclass(frozen=True, slots=True, eq=False)
class NearLightModel:
    """Directions of the lights, each a polynomial in position.

    directions : float32 array of shape (K, 2, 3): for every position monomial a's two components in R, G, B
    """

    directions: Float32Array

    @classmethod
    def of(cls, samples: BallSamples, slope: Float64Array, shape: tuple[int, int]) -> NearLightModel:
        """Return the directions that gentle slopes, float64 array of shape (N, 2), of a full-size field (H, W) show.

        Where no slope is gentle every direction is zero, i.e. uninformative.
        """
        gentle = np.linalg.norm(slope, axis=1) < GENTLE
        place = monomials(field_position(samples.column[gentle], samples.row[gentle], shape), PLACE_DEGREE)
        features = direction_features(slope[gentle], place)
        bends = _bends(slope[gentle], place[:, :1])
        lit = lit_by(samples.intensity[gentle], slope[gentle])
        dear = np.repeat([float(i + j > OLD_PLACE_DEGREE) for i, j in position_exponents(PLACE_DEGREE)], 2)
        information = 0.5 * float((slope[gentle] ** 2).sum()) / max(len(np.unique(samples.ball[gentle])), 1)
        penalty = np.diag(np.append(CUBIC_DOUBT * np.sqrt(information) * dear, np.zeros(bends.shape[1])))
        design = np.concatenate([np.concatenate([features, bends], axis=1), penalty])
        directions = np.linalg.lstsq(design, np.concatenate([lit, np.zeros((len(penalty), 3))]), rcond=None)[0]
        return cls(directions[: features.shape[1]].reshape(place.shape[1], 2, 3).astype(np.float32))

    @property
    def degree(self) -> int:
        """Degree in position of its directions."""
        return _DEGREES[len(self.directions)]

    @property
    def min_volume(self) -> float:
        """Volume of the directions, with its sign, below which it is not taken to fall."""
        axis = np.linspace(-1.0, 1.0, VOLUME_PLACES)
        place = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        directions = np.tensordot(monomials(place, self.degree), self.directions.astype(np.float64), axes=1)
        median = float(np.median(np.cross(directions[:, 0], directions[:, 1]).sum(axis=1))) + 0.0  # no zero has a sign
        return float(np.copysign(max(VOLUME_SHARE * abs(median), MIN_VOLUME), median))

    def seen(self, intensity: Float32Array, place: Float64Array) -> Float32Array:
        """Return slopes p, q and brightness 1 / s of intensities (N, 3) at position variables (N, 2): shape (N, 3)."""
        directions = np.tensordot(monomials(place, self.degree), self.directions.astype(np.float64), axes=1)
        return _solved(intensity, directions[:, 0], directions[:, 1], self.min_volume)

    def seen_rows(self, values: Float32Array, across: Float32Array, down: Float32Array) -> Float32Array:
        """Return the same of whole rows (h, w, 3) at position variables `across` (w,) and `down` (h,)."""
        place = np.stack(np.broadcast_arrays(across[None, :], down[:, None]), axis=-1).reshape(-1, 2)
        return self.seen(values.reshape(-1, 3), place.astype(np.float64)).reshape(values.shape)

    def by_powers(self) -> Float32Array:
        """Return directions by component, channel, and powers of column and row position: float32 array (2, 3, 4,
        4)."""
        powers = PLACE_DEGREE + 1
        table = np.zeros((2, 3, powers, powers), np.float32)
        for term, (i, j) in enumerate(position_exponents(self.degree)):
            table[:, :, i, j] = self.directions[term]
        return table

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        return {"directions": self.directions}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> NearLightModel:
        """Return the field that `arrays` wrote; KeyError or ValueError when malformed."""
        directions = np.asarray(arrays["directions"], np.float32)
        if directions.shape[1:] != (2, 3) or len(directions) not in _DEGREES or not np.isfinite(directions).all():
            raise ValueError(f"directions of lights of shape {directions.shape}")
        return cls(directions)


def direction_features(slope: Float64Array, place: Float64Array) -> Float64Array:
    """Return what directions are multiplied by to give a·g: float64 array of shape (N, 2 K).

    slope : float64 array of shape (N, 2)
    place : float64 array of shape (N, K), monomials of position
    """
    return np.asarray((place[:, :, None] * slope[:, None, :]).reshape(len(place), 2 * place.shape[1]))


def _bends(slope: Float64Array, place: Float64Array) -> Float64Array:
    """Return squares and cubes of slopes: what skins that are not matt add, so that a is what holds at slope zero."""
    p, q = slope.T
    square = (slope**2).sum(axis=1, keepdims=True)
    return np.concatenate([np.stack([p * p, p * q, q * q], axis=1), square * direction_features(slope, place)], axis=1)


def lit_by(intensity: Float32Array, slope: Float64Array) -> Float64Array:
    """a·g of a matt skin that shows intensities (N, 3) at slopes (N, 2): float64 array of shape (N, 3)."""
    return np.asarray(intensity * np.sqrt(1.0 + (slope**2).sum(axis=1, keepdims=True)) - 1.0)


def _solved(intensity: Float32Array, across: Float64Array, down: Float64Array, least: float) -> Float32Array:
    """p, q, 1 / s of shape (N, 3) by Cramer's rule; `across` and `down`, (N, 3), are a's components by channel.

    least : as of `NearLightModel.min_volume`
    """
    ones = np.ones(3)
    volume = np.cross(across, down)
    whole = volume.sum(axis=1)
    whole = np.maximum(whole, least) if least > 0.0 else np.minimum(whole, least)
    # So written that untouched skin has brightness 1 where the volume is held up too.
    brightness = np.maximum(1.0 + ((intensity - 1.0) * volume).sum(axis=1) / whole, MIN_BRIGHTNESS)
    p = (intensity * np.cross(down, ones)).sum(axis=1) / (whole * brightness)
    q = (intensity * np.cross(ones, across)).sum(axis=1) / (whole * brightness)
    return np.stack([p, q, brightness], axis=1).astype(np.float32)
