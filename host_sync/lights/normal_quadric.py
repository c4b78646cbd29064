"""What skin shows as a quadratic function of its normal, whose coefficients change over the field.

Whatever lights there are, a diffuse coat reflects within a few per cent such a function (Basri and Jacobs, "Lambertian
reflectance and linear subspaces", PAMI 25, 2003), and makers of gel sensors describe them so. It knows no elevation and
no cast shadow, but where it explains the balls it holds between them, too, for every slope and place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.illumination import IlluminationMap
from device.inverse_map.model import InverseMap
from device.inverse_map.polynomial_features import blocks_of, field_position, monomials
from device.surface.fields import Float32Array, Float64Array
from host_sync.lights.lamp_slopes import (
    BESIDE,
    INTENSITY_SIGMA,
    READER_STEPS,
    STEP,
    SURFACE_SIGMA,
    bounded,
    gauss_newton_step,
)

TERMS: Final = 8
"""Three components of a normal and six products of them, less one: the squares add up to 1."""

DARK_LIGHT: Final = 1e-3
"""Light of untouched skin, of its mean over the field, that nothing darker is divided by."""

CONTRAST_SLOPE: Final = 0.35
"""Slope of the skin whose intensity tells a quadric's contrast, 19 degrees: a ball's on the mean."""

MIN_CONTRAST: Final = 1e-3
CONTRAST_PLACES: Final = 6
"""Places along each side of the field where it is asked for, and directions of the slope."""


@dataclass(frozen=True, slots=True, eq=False)
class NormalQuadric:
    """The quadratic function of a field of skin.

    shape : (H, W) of the full-size field, pixels
    degree : of each coefficient's polynomial in position
    coefficients : float64 array of shape (`TERMS`, K, 3), by term of the normal, monomial of position and channel
    light : of untouched skin, which the polynomials are divided by; None where they are not
    """

    shape: tuple[int, int]
    degree: int
    coefficients: Float64Array
    light: IlluminationMap | None

    def contrast(self) -> float:
        """By how much skin of `CONTRAST_SLOPE` differs from level skin, median over the field and directions."""
        rows, columns = self.shape
        even = (np.arange(CONTRAST_PLACES) + 0.5) / CONTRAST_PLACES
        across, down, angle = (part.ravel() for part in np.meshgrid(even * columns, even * rows, 2.0 * np.pi * even))
        slope = CONTRAST_SLOPE * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return max(float(np.median(np.abs(self.at(across, down).shown(slope) - 1.0))), MIN_CONTRAST)

    def at(self, column: Float64Array, row: Float64Array) -> QuadricSkin:
        """Skin at pixels of these columns and rows (N,)."""
        place = field_position(column, row, self.shape)
        by_place = monomials(place, self.degree) @ self.coefficients.swapaxes(0, 1).reshape(-1, TERMS * 3)
        by_place = by_place.reshape(-1, TERMS, 3)
        if self.light is not None:
            by_place /= np.maximum(self.light.at(place), DARK_LIGHT)[:, None, :]
        return QuadricSkin(by_place)


@dataclass(frozen=True, slots=True, eq=False)
class QuadricSkin:
    """The quadratic function at N places.

    coefficients : float64 array of shape (N, `TERMS`, 3)
    """

    coefficients: Float64Array

    def shown(self, slope: Float64Array) -> Float64Array:
        """Intensity (N, 3) of slopes (N, 2), divided by that of untouched skin at the same place; 0 at least."""
        terms = normal_terms(slope)[:, None, :]
        return np.asarray(np.maximum(1.0 + np.matmul(terms, self.coefficients)[:, 0], 0.0))

    def shown_and_changes(self, slope: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Intensity (N, 3) as `shown`, and what it changes with both slopes: shape (N, 3, 2)."""
        here, by_p, by_q = (self.shown(slope + STEP * beside) for beside in BESIDE.T)
        return here, np.stack([by_p - here, by_q - here], axis=-1) / STEP

    def slopes(self, intensity: Float64Array, read: Float64Array) -> Float64Array:
        """Slopes (N, 2) that explain intensities (N, 3), from slopes as they are known before."""
        slope, weight = read, np.full_like(intensity, INTENSITY_SIGMA**-2)
        for _ in range(READER_STEPS):
            shown, change = self.shown_and_changes(slope)
            slope = slope + bounded(gauss_newton_step(change, weight, intensity - shown, read - slope, SURFACE_SIGMA))
        return slope


def normal_terms(slope: Float64Array) -> Float64Array:
    """Terms (N, `TERMS`) of the normals of slopes (N, 2), less those of level skin."""
    up = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=1))
    x, y = -slope[:, 0] * up, -slope[:, 1] * up
    return np.stack([x, y, up - 1.0, x * x, x * y, y * y, x * up, y * up], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class FittedQuadric:
    """A quadric that was fitted to balls.

    model : of all balls
    folds : as it would be without every K-th ball, from each of the first K on
    """

    model: NormalQuadric
    folds: tuple[NormalQuadric, ...]


@dataclass(frozen=True, slots=True, eq=False)
class QuadricReader:
    """What a quadric makes of an inverse map's slopes."""

    inverse: InverseMap
    model: NormalQuadric

    def in_frame(self, _image: NormalizedImage) -> QuadricReader:
        """The same reader: a quadric knows nothing of the skin around."""
        return self

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Slopes p and q, float64 array of shape (N, 2), of intensities (N, 3) at pixels (N,)."""
        slopes = self.inverse.predict(intensity, column, row)
        for part in blocks_of(len(slopes)):
            skin = self.model.at(column[part].astype(np.float64), row[part].astype(np.float64))
            slopes[part] = skin.slopes(intensity[part].astype(np.float64), slopes[part])
        return slopes
