"""What colour a slope has: the root of intensity as a polynomial in slope and place, fitted to a calibration's balls.

The inverse map goes the other way. This one is only as good as it must be to draw a test pattern as the instrument
would see it; its own errors are the same with and without noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.inverse_map.polynomial_features import field_position, monomials
from device.surface.fields import Float32Array, Float64Array
from device.surface.stereographic import stereographic_from_slope
from host_sync.denoising.frame_noise import root_of

SLOPE_DEGREE: Final = 4
PLACE_DEGREE: Final = 1
MAX_SAMPLES: Final = 20_000
PENALTY: Final = 1e-6
STEP: Final = 1e-3
"""Slope over which the colour's change is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class SlopeColour:
    """The fitted colours.

    coefficients : float64 array of shape (terms, 3)
    """

    coefficients: Float64Array

    @classmethod
    def of(cls, samples: BallSamples, shape: tuple[int, int]) -> SlopeColour:
        """The colours that samples of balls on a full-size field of `shape` (H, W) show."""
        part = slice(None, None, max(1, len(samples.p) // MAX_SAMPLES))
        place = field_position(samples.column[part].astype(np.float64), samples.row[part].astype(np.float64), shape)
        slope = stereographic_from_slope(samples.p[part].astype(np.float64), samples.q[part].astype(np.float64))
        features = _features(slope, place)
        gram = features.T @ features + PENALTY * len(features) * np.eye(features.shape[1])
        root = root_of(samples.intensity[part]).astype(np.float64)
        return cls(np.asarray(np.linalg.solve(gram, features.T @ root)))

    def root(self, p: Float64Array, q: Float64Array, place: tuple[float, float]) -> Float32Array:
        """Root of intensity (h, w, 3) of slopes (h, w) at one place, two position variables."""
        slope = stereographic_from_slope(p.ravel(), q.ravel())
        features = _features(slope, np.broadcast_to(np.array(place), (p.size, 2)))
        return np.asarray((features @ self.coefficients).reshape(*p.shape, 3), np.float32)

    def change(self, place: tuple[float, float]) -> Float64Array:
        """Change of the root of intensity with either slope of flat skin at a place: float64 array of shape (3, 2)."""
        sides = [
            self.root(np.array([[sign * STEP * across]]), np.array([[sign * STEP * (1 - across)]]), place)[0, 0]
            for across in (1, 0)
            for sign in (1, -1)
        ]
        return np.stack([sides[0] - sides[1], sides[2] - sides[3]], axis=-1).astype(np.float64) / (2.0 * STEP)

    def intensity_change(self, u: Float64Array, place: Float64Array) -> Float64Array:
        """Change of intensity with stereographic slope, float64 array of shape (N, 3, 2).

        u, place : float64 arrays of shape (N, 2), stereographic slopes and position variables
        """
        steps = STEP * np.eye(2)
        sides = [[(_features(u + sign * step, place) @ self.coefficients) ** 2 for sign in (1, -1)] for step in steps]
        return np.stack([more - less for more, less in sides], axis=-1) / (2.0 * STEP)


def _features(u: Float64Array, place: Float64Array) -> Float64Array:
    by_slope, by_place = monomials(u, SLOPE_DEGREE), monomials(place, PLACE_DEGREE)
    return np.asarray((by_slope[:, :, None] * by_place[:, None, :]).reshape(len(u), -1))
