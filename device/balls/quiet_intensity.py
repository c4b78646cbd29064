"""Intensity of a ball's pixels without most of their noise: what an inverse map is taught with.

A map that is fitted from noisy colours to true slopes reads flatter than the truth: least squares finds the mean slope
of all pixels that look so, and noise mixes gentler ones among them (regression dilution; Fuller, "Measurement Error
Models", 1987). It flattens all of an object by one share, which integration keeps, while noise itself averages out. On
a ball intensity is smooth, so that its noise can be averaged beforehand: a polynomial over the contact follows the
ball, and a Gaussian over neighbours inside the contact what the polynomial leaves.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, Float64Array

DEGREE: Final = 5
SIGMA_PX: Final = 2.0
"""Standard deviation of the Gaussian."""

SIGMA_SHARE: Final = 0.03
"""The same as a share of the contact's radius, at most: a small ball bends within few pixels."""

OUTLYING: Final = 4.0
"""Times the median of what the polynomial leaves from which a pixel counts less: dust, a hair, skin that has lifted."""

ROUNDS: Final = 3
"""Fits of the polynomial, each with the weights that the last one gives."""

MIN_PIXELS_PER_TERM: Final = 10
"""Contacts with fewer pixels keep their noise."""


def quiet_intensity(
    intensity: Float32Array, row: NDArray[np.intp], column: NDArray[np.intp], contact_radius_px: float
) -> Float32Array:
    """Intensities of a ball's pixels with their noise averaged, float32 array of shape (N, 3).

    intensity : float32 array of shape (N, 3), as seen
    row, column : int arrays of shape (N,), each pixel once
    """
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    if len(row) < MIN_PIXELS_PER_TERM * len(powers):
        return intensity
    across, down = ((place - place.mean()) / contact_radius_px for place in (column, row))
    terms = np.stack([across**i * down**j for i, j in powers], axis=-1)
    seen, weight = intensity.astype(np.float64), np.ones(len(row))
    for _ in range(ROUNDS):
        weighed = terms * weight[:, None]
        gram = weighed.T @ terms + 1e-9 * len(terms) * np.eye(len(powers))
        left = seen - terms @ np.linalg.solve(gram, weighed.T @ seen)
        length = np.linalg.norm(left, axis=1)
        outlying = OUTLYING * max(float(np.median(length)), 1e-6)
        weight = np.where(length > outlying, (outlying / np.maximum(length, outlying)) ** 2, 1.0)
    sigma_px = min(SIGMA_PX, SIGMA_SHARE * contact_radius_px)
    return np.asarray(seen - left + _averaged(left, weight, row, column, sigma_px), np.float32)


def _averaged(
    left: Float64Array, weight: Float64Array, row: NDArray[np.intp], column: NDArray[np.intp], sigma_px: float
) -> Float64Array:
    """Weighted means of values (N, 3) over neighbours that are there."""
    here = row - row.min(), column - column.min()
    size = int(here[0].max()) + 1, int(here[1].max()) + 1
    values, known = np.zeros((*size, left.shape[1]), np.float32), np.zeros(size, np.float32)
    values[here], known[here] = weight[:, None] * left, weight
    total, whole = (cv2.GaussianBlur(part, (0, 0), sigma_px)[here] for part in (values, known))
    return np.asarray(total / np.maximum(whole, 1e-6)[:, None], np.float64)
