"""Numbers of a light model that a bundle adjustment searches for, and what they may be."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from device.surface.fields import Float64Array

COAT: Final = ("fall_off", "roughness", "gloss", "log_width", "log_tail", "tilt_gain", "beam")
COAT_START: Final = np.array([2.0, 0.3, 0.1, np.log(0.35), np.log(2.0), 0.0, 0.2])
COAT_SIGMA: Final = np.array([1.0, 0.5, 0.3, 0.5, 1.0, 0.15, 0.5])
_COAT_LOW: Final = np.array([0.0, 0.0, 0.0, np.log(0.08), 0.0, -0.9, 0.0])
_COAT_HIGH: Final = np.array([4.0, 1.0, 0.95, np.log(0.8), np.log(60.0), 2.0, 1.0])
_LOW_UP: Final = np.log(0.04)
_HIGH_UP: Final = np.log(5.0)
_FARTHEST: Final = 4.0
_LARGEST: Final = (2.0, 1.6)
"""Bounds of the places of sources, and of their length and height."""


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """Numbers of a model with S sources and C channels, and of B balls.

    place, extent : of sources, shape (S, 3) with the logarithm of the height, and (S, 2), length and height
    strength, haze, albedo : see `LightModel`, shape (C, S), (C,) and (1,)
    coat : numbers of the coat, in the order of `COAT`
    shift : of the balls' centres, column and row, pixels, shape (B, 2)
    residual : shape (C, terms * places)
    """

    place: Float64Array
    extent: Float64Array
    strength: Float64Array
    haze: Float64Array
    albedo: Float64Array
    coat: Float64Array
    shift: Float64Array
    residual: Float64Array

    def packed(self) -> Float64Array:
        """Return all numbers in their order."""
        return np.concatenate([np.ravel(getattr(self, one.name)) for one in fields(self)])

    def unpacked(self, values: Float64Array) -> Numbers:
        """Return numbers with other values, kept within what a sensor can have."""
        found, at = {}, 0
        for one in fields(self):
            own = getattr(self, one.name)
            found[one.name] = values[at : at + own.size].reshape(own.shape).copy()
            at += own.size
        np.clip(found["place"][:, :2], -_FARTHEST, _FARTHEST, out=found["place"][:, :2])
        np.clip(found["place"][:, 2], _LOW_UP, _HIGH_UP, out=found["place"][:, 2])
        np.clip(found["extent"], 0.0, _LARGEST, out=found["extent"])
        np.clip(found["coat"], _COAT_LOW, _COAT_HIGH, out=found["coat"])
        for name in ("strength", "haze", "albedo"):
            np.maximum(found[name], 0.0, out=found[name])
        return Numbers(**found)

    @property
    def sources(self) -> Float64Array:
        """Sources see `LightModel`."""
        return np.concatenate([self.place[:, :2], np.exp(self.place[:, 2:]), self.extent], axis=1)

    @property
    def coat_change(self) -> Float64Array:
        """Derivatives of `LightModel.coat`, but the camera's, by the coat's numbers: shape (8, 7)."""
        roughness, width, tail = self.coat[1], np.exp(2.0 * self.coat[3]), np.exp(self.coat[4])
        square = roughness**2
        change = np.zeros((len(self.coat) + 1, len(self.coat)))
        change[0, 0] = change[3, 2] = change[6, 5] = change[7, 6] = 1.0
        change[1, 1] = -0.33 * roughness / (square + 0.33) ** 2
        change[2, 1] = 0.081 * roughness / (square + 0.09) ** 2
        change[4, 3], change[5, 4] = 2.0 * width, tail
        return change
