"""Height of the lights over the skin, estimated from balls in different places.

Under a point at the height h over the place (X, Y) a matt skin of slope g shows, divided by its reference,
I √(1 + |g|²) = 1 + a·g with a = (x - X, y - Y) / h: from pixel to pixel a changes by 1 / h, the same in every channel
and in mixtures of lights. Lights shine more to one side than to the other, so that directions bend over the field (see
`device.inverse_map.near_light`), but a few balls leave such bends to chance: the one number is fitted first, then as
much of the bends as the balls determine well.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.inverse_map.near_light import GENTLE, direction_features, lit_by
from device.inverse_map.polynomial_features import field_position, monomials, position_exponents
from device.surface.fields import Float64Array

PLACE_DEGREE: Final = 2
"""Degree in position of the directions."""

MAX_SAMPLES: Final = 20_000
MIN_SAMPLES: Final = 100
MIN_SINGULAR_VALUE: Final = 0.1
"""Singular value, as a share of the largest, from which a combination of bends is taken; a dozen balls reach 0.19."""


def nearness_per_px(training: BallSamples, shape: tuple[int, int]) -> float:
    """Return one over the height of the lights, per pixel of a full-size field (H, W); 0 for lights that are far away.

    0 too where no slope is gentle: then nothing determines it.
    """
    gentle = np.flatnonzero(np.hypot(training.p, training.q) < GENTLE)
    if gentle.size < MIN_SAMPLES:
        return 0.0
    rows = gentle[:: max(1, gentle.size // MAX_SAMPLES)]
    slope = np.stack([training.p[rows], training.q[rows]], axis=-1).astype(np.float64)
    place = field_position(training.column[rows].astype(np.float64), training.row[rows].astype(np.float64), shape)
    brightness = lit_by(training.intensity[rows], slope)
    features = direction_features(slope, monomials(place, PLACE_DEGREE))
    directions = _of_points(slope, place, brightness, shape)
    directions += np.linalg.lstsq(features, brightness - features @ directions, rcond=MIN_SINGULAR_VALUE)[0]
    return max(0.5 * sum(float(directions[term].mean()) / pixels for term, pixels in _changes(shape)), 0.0)


def _of_points(
    slope: Float64Array, place: Float64Array, brightness: Float64Array, shape: tuple[int, int]
) -> Float64Array:
    """Return how directions change over the field under points of one height: float64 array (features, channels).

    A ball's apex is nearer to the lights than its rim and brighter: a constant and |g|² take that up.
    """
    reach = (0.5 * np.array(shape[::-1]) * place * slope).sum(axis=1)
    far = np.stack([np.ones_like(reach), *slope.T, (slope**2).sum(axis=1)], axis=-1)
    alike, _ = np.linalg.qr(far)
    reach -= alike @ (alike.T @ reach)
    nearness = float((reach @ brightness).mean() / max(reach @ reach, 1e-12))
    directions = np.zeros((2 * len(position_exponents(PLACE_DEGREE)), brightness.shape[1]))
    for term, pixels in _changes(shape):
        directions[term] = nearness * pixels
    return directions


def _changes(shape: tuple[int, int]) -> list[tuple[int, float]]:
    """Return the features that say how a changes along the axis of its component, and pixels in a unit of position."""
    exponents = position_exponents(PLACE_DEGREE)
    return [(2 * exponents.index((1, 0)), 0.5 * shape[1]), (2 * exponents.index((0, 1)) + 1, 0.5 * shape[0])]
