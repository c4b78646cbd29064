"""Height uncertainty by drawing slope errors and integrating each draw.

Slope errors are correlated over the field, so that no formula per pixel can give the height's. The draws are levelled
as the height map is: σ is that of the height above untouched skin, which is what the user sees.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from device.fft_integrator import integrate_dct
from device.inverse_map import InverseMap
from device.photometry import IntensityImage
from device.surface import Float32Array, GradientField, HeightMap, MaskArray
from host_sync.calibration.slope_error import SlopeError

DRAWS: Final = 16
WIDEST_PX: Final = 512
"""Draws are integrated at this size at most: long wavelengths carry nearly all of the height error."""

LEAST_WEIGHT: Final = 0.01
RAISED_SPREAD: Final = 0.5
"""Standard deviation of how much higher or lower than the balls' an object's slopes lie, in apex elevations."""

CONTRADICTION_PX: Final = 8.0
"""Standard deviation of the Gaussian that takes pixel noise out of what integration removed."""

CONTRADICTION_CELL_PX: Final = 4
"""The blurs work on cells of so many pixels: half of the narrower one's standard deviation."""

SlopePair = tuple[Float32Array, Float32Array]


def contradicted_slope(gradients: GradientField, p: Float32Array, q: Float32Array) -> Float32Array:
    """Standard deviation of the slope error, over patches, that the surface itself betrays: float32 array (H, W).

    Slopes that belong to no surface cannot be right. Of an error without preference integration removes half the power
    and keeps the other half, so that twice of what it removed is the error (p and q are the integrated slopes).
    """
    rows, columns = gradients.p.shape
    size = (max(columns // CONTRADICTION_CELL_PX, 1), max(rows // CONTRADICTION_CELL_PX, 1))
    sigma = CONTRADICTION_PX / CONTRADICTION_CELL_PX
    total = np.zeros(size[::-1], np.float32)
    for estimated, integrated in ((gradients.p, p), (gradients.q, q)):
        removed = np.where(gradients.valid & np.isfinite(integrated), estimated - integrated, np.float32(0.0))
        total += cv2.GaussianBlur(_shrunk(removed, size), (0, 0), sigma) ** 2
    patches = np.sqrt(cv2.GaussianBlur(total, (0, 0), 4.0 * sigma))
    return np.asarray(cv2.resize(patches, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)


def raised_slopes(
    gradients: GradientField, intensity: IntensityImage, inverse: InverseMap, error: SlopeError
) -> SlopePair:
    """By how much the slopes (p, q) would change were the skin one ball's apex higher than the balls taught."""
    darker = intensity.values / (1.0 + np.asarray(error.raised_shade, np.float32))
    moved = inverse.gradients(replace(intensity, values=darker))
    return moved.p - gradients.p, moved.q - gradients.q


def height_sigma_um(
    height: HeightMap,
    gradients: GradientField,
    raised: SlopePair,
    contradiction: Float32Array,
    error: SlopeError,
    at_rest: MaskArray,
    seed: int = 0,
) -> Float32Array:
    """Standard uncertainty of the height: float32 array of shape (H, W), µm, NaN where invalid.

    height : levelled, zero at untouched skin
    raised : as `raised_slopes` returns it
    contradiction : as `contradicted_slope` returns it
    at_rest : where the height map's zero was taken
    """
    rows, columns = gradients.p.shape
    factor = max(1, int(np.ceil(columns / WIDEST_PX)))
    size = (max(columns // factor, 3), max(rows // factor, 3))
    scale = _shrunk(_error_scale(gradients), size)
    raised_small = [_shrunk(np.where(gradients.valid, slope, 0.0), size) for slope in raised]
    zero = _shrunk(at_rest, size)
    betrayed = _shrunk(contradiction, size)
    zero /= max(float(zero.sum()), 1e-6)
    rng = np.random.default_rng(seed)
    total = np.zeros(scale.shape)
    reduction = columns / size[0]
    for _ in range(DRAWS):
        lift = np.float32(RAISED_SPREAD * rng.standard_normal())
        p, q = (_slope_draw(rng, scale, betrayed, error, reduction) + lift * slope for slope in raised_small)
        z_um = integrate_dct(p, q, height.pitch_um * reduction)
        total += (z_um - float((z_um * zero).sum())) ** 2
    sigma = cv2.resize(np.sqrt(total / DRAWS).astype(np.float32), (columns, rows), interpolation=cv2.INTER_LINEAR)
    scaled = error.scale_share * np.abs(height.z_um)
    return np.where(gradients.valid, np.hypot(sigma, scaled), np.nan).astype(np.float32)


def _error_scale(gradients: GradientField) -> Float32Array:
    """Factor by which the slope error of a flat, trusted pixel grows: with slope, and as confidence falls."""
    confidence = np.maximum(gradients.weight, LEAST_WEIGHT)
    slope = np.where(gradients.valid, gradients.p**2 + gradients.q**2, 0.0)
    return np.asarray((1.0 + np.minimum(slope, 9.0)) / np.sqrt(confidence), np.float32)


def _shrunk(field: Float32Array | MaskArray, size: tuple[int, int]) -> Float32Array:
    return np.asarray(cv2.resize(field.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def _slope_draw(
    rng: np.random.Generator, scale: Float32Array, betrayed: Float32Array, error: SlopeError, reduction: float
) -> Float32Array:
    """One slope component's error; independent pixels average out under reduction, patches do not."""
    pixel = rng.standard_normal(scale.shape).astype(np.float32) * np.float32(np.radians(error.pixel_deg) / reduction)
    sigma_px = max(error.patch_px / reduction, 0.5)
    patch = cv2.GaussianBlur(rng.standard_normal(scale.shape).astype(np.float32), (0, 0), sigma_px)
    amplitude = np.hypot(np.radians(error.patch_deg) * scale, betrayed) / max(float(patch.std()), 1e-6)
    return np.asarray(pixel * scale + patch * amplitude, np.float32)
