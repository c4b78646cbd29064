"""Directions of lights as seen from each place, by which any of them can be predicted from the others.

A matt skin of slope g shows, divided by its reference, s I_k = 1 + a_k(x, y)·g under light k, with s = √(1 + |g|²).
Four lights or more are more equations than unknowns (1 / s, p / s, q / s): what one light shows can be held against
what the others predict. A light that is hidden or mirrored is found that way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.inverse_map.near_light import GENTLE, direction_features, lit_by
from device.inverse_map.polynomial_features import field_position, monomials, position_exponents
from device.surface.fields import Float32Array, Float64Array

NEEDED: Final = 3
"""Lights that tell brightness and both slopes; of more, one can be left out."""

NEAR_DEGREE: Final = 2
FAR_DEGREE: Final = 0
NUMBERS_OF_TERMS: Final = tuple(len(position_exponents(degree)) for degree in (FAR_DEGREE, NEAR_DEGREE))
MIN_BALLS: Final = 6
"""Of fewer balls the lights' directions are taken to be the same all over the field."""

RARE_PERCENT: Final = 99.5
MIN_TOLERANCE: Final = 0.1
MARGIN: Final = 1.25
"""A light is left out where it is off by more than that percentile of ball pixels is, times the margin."""


@dataclass(frozen=True, slots=True, eq=False)
class MattLights:
    """Directions of lights.

    directions : float32 array of shape (N, K, 2), a's components by light and monomial of place
    tolerance : float32 array of shape (N,), intensity by which a light may differ from what the others predict
    """

    directions: Float32Array
    tolerance: Float32Array

    @classmethod
    def of(cls, samples: BallSamples, shape: tuple[int, int]) -> MattLights:
        """Return what gentle slopes on balls show, of a field (H, W)."""
        slope = np.stack([samples.p, samples.q], axis=-1).astype(np.float64)
        place = field_position(samples.column.astype(np.float64), samples.row.astype(np.float64), shape)
        degree = NEAR_DEGREE if len(np.unique(samples.ball)) >= MIN_BALLS else FAR_DEGREE
        gentle = np.linalg.norm(slope, axis=1) < GENTLE
        there = monomials(place[gentle], degree)
        p, q = slope[gentle].T
        bends = np.stack([p * p, p * q, q * q, p**3, p * p * q, p * q * q, q**3], axis=1)
        features = np.concatenate([direction_features(slope[gentle], there), bends], axis=1)
        penalty = 1e-3 * np.sqrt(max(int(gentle.sum()), 1)) * np.eye(features.shape[1])
        lit = lit_by(samples.intensity[gentle], slope[gentle])
        stacked = np.concatenate([lit, np.zeros((len(penalty), lit.shape[1]))])
        found = np.linalg.lstsq(np.concatenate([features, penalty]), stacked, rcond=None)[0]
        directions = found[: 2 * there.shape[1]].reshape(there.shape[1], 2, -1).transpose(2, 0, 1).astype(np.float32)
        lights = cls(np.ascontiguousarray(directions), np.full(len(directions), np.inf, np.float32))
        off = np.percentile(np.abs(lights.disagreement(samples.intensity, place)), RARE_PERCENT, axis=0)
        return cls(lights.directions, np.maximum(MARGIN * off, MIN_TOLERANCE).astype(np.float32))

    @property
    def degree(self) -> int:
        """Degree in place of the directions."""
        return NEAR_DEGREE if self.directions.shape[1] == len(position_exponents(NEAR_DEGREE)) else FAR_DEGREE

    def disagreement(self, intensity: Float32Array, place: Float64Array) -> Float64Array:
        """By how much each light differs from what the others predict: (n, N), 0 where they predict nothing.

        intensity : float32 array of shape (n, N)
        place : position variables, float64 array of shape (n, 2)
        """
        if len(self.directions) <= NEEDED:
            return np.zeros(intensity.shape)
        a = np.tensordot(monomials(place, self.degree), self.directions.astype(np.float64), axes=(1, 1))
        system = np.concatenate([np.ones((*a.shape[:2], 1)), a], axis=-1)
        gram = np.einsum("nka,nkb->nab", system, system) + 1e-6 * np.eye(3)
        inverse = np.linalg.inv(gram)
        known = np.einsum("nab,nkb,nk->na", inverse, system, intensity)
        left = intensity - np.einsum("nka,na->nk", system, known)
        leverage = np.einsum("nka,nab,nkb->nk", system, inverse, system)
        return np.asarray(left / np.maximum(1.0 - leverage, 0.05))
