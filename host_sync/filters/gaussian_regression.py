"""Areal Gaussian regression filter of first order (ISO 16610-61 with the regression of 16610-31), for one mask.

s(x, y) = exp(-π (x² + y²) / (α λ)²) / (α λ)² with α = √(ln 2 / π) transmits 50 % at the nesting index λ.

Why a local plane: at borders and beside holes some weights are missing, and a weighted mean of the rest bends every
slope. The filter returns the value of the weighted least-squares plane: a tilt passes unchanged everywhere, and where
no pixel is missing the value equals the mean.

Terms that depend on the mask only are computed once for a surface and its samples.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from device.surface import Float32Array, Float64Array, MaskArray

ALPHA: Final = float(np.sqrt(np.log(2.0) / np.pi))
REACH: Final = 4.0
"""Reach of the weights, standard deviations."""

MAX_DIRECT_PX: Final = 24
"""Longer kernels are applied by Fourier transform, whose cost does not depend on the reach."""

_MIN_DETERMINANT: Final = 1e-4
"""Normalised determinant below which the pixels do not span a plane; their mean is used."""

_MOMENTS: Final = ((0, 0), (1, 0), (0, 1))
"""Powers of the coordinates, across and down, in the sums over heights."""


class GaussianRegression:
    """The filter of one nesting index on one mask.

    Parameters
    ----------
    valid : bool array of shape (H, W)
    cutoff_px : the nesting index, pixels
    """

    def __init__(self, valid: MaskArray, cutoff_px: float) -> None:
        self._valid = valid
        self._kernels = _kernels(cutoff_px)
        self._shares = self._plane_shares() if valid.any() else ()

    def mean(self, z: Float32Array) -> Float32Array:
        """Return gaussian mean at each valid pixel: float32 array of shape (H, W), NaN elsewhere.

        z : float32 array of shape (H, W), finite where valid
        """
        if not self._shares:
            return np.full(z.shape, np.nan, np.float32)
        # Subtracting the mean keeps float32 precise to a thousandth of the relief at any height.
        level = np.float32(z[self._valid].mean(dtype=np.float64))
        filled = np.where(self._valid, z - level, np.float32(0.0))
        mean = np.full(z.shape, level, np.float32)
        for share, sums in zip(self._shares, self._sums(filled, _MOMENTS), strict=True):
            mean += share * sums
        mean[~self._valid] = np.nan
        return mean

    def _plane_shares(self) -> tuple[Float32Array, ...]:
        """Return factors on the three sums over heights that give the plane's value: arrays of shape (H, W)."""
        powers = (*_MOMENTS, (2, 0), (1, 1), (0, 2))
        n, x, y, xx, xy, yy = self._sums(self._valid.astype(np.float32), powers)
        n = np.maximum(n, np.float32(1e-6))
        by_n, by_x, by_y = xx * yy - xy * xy, xy * y - x * yy, x * xy - xx * y
        determinant = n * by_n + x * by_x + y * by_y
        spans = self._valid & (determinant > _MIN_DETERMINANT * n**3)
        inverse = np.where(spans, np.float32(1.0) / np.where(spans, determinant, np.float32(1.0)), np.float32(0.0))
        return np.where(spans, by_n * inverse, np.float32(1.0) / n), by_x * inverse, by_y * inverse

    def _sums(self, values: Float32Array, powers: tuple[tuple[int, int], ...]) -> list[Float32Array]:
        """Return sums of values times weight times x^across y^down around each pixel; zero beyond the border."""
        reach = self._kernels[0].size // 2
        if reach <= MAX_DIRECT_PX:
            border = cv2.BORDER_CONSTANT
            pairs = [(self._kernels[across], self._kernels[down]) for across, down in powers]
            return [
                np.asarray(cv2.sepFilter2D(values, cv2.CV_32F, *pair, borderType=border), np.float32) for pair in pairs
            ]
        reaches = [min(reach, side - 1) for side in values.shape]
        size = [scipy.fft.next_fast_len(side + far, real=True) for side, far in zip(values.shape, reaches, strict=True)]
        spectrum = scipy.fft.rfft2(values, size)
        down_by = [_transfer(kernel, reaches[0], size[0]) for kernel in self._kernels]
        across_by = [_transfer(kernel, reaches[1], size[1])[: spectrum.shape[1]] for kernel in self._kernels]
        rows, columns = values.shape
        return [
            np.asarray(
                scipy.fft.irfft2(spectrum * down_by[down][:, None] * across_by[across], size)[:rows, :columns],
                np.float32,
            )
            for across, down in powers
        ]


def gaussian_mean(z: Float32Array, cutoff_px: float) -> Float32Array:
    """Return gaussian mean of the valid pixels with a cut-off in pixels: float32 array (H, W), NaN where `z` is NaN."""
    return GaussianRegression(np.isfinite(z), cutoff_px).mean(z)


def _kernels(cutoff_px: float) -> tuple[Float64Array, ...]:
    """Return gaussian weights along one axis, and the same times x and x²; x in standard deviations."""
    sigma_px = ALPHA * cutoff_px / np.sqrt(2.0 * np.pi)
    reach = max(int(np.ceil(REACH * sigma_px)), 1)
    x = np.arange(-reach, reach + 1) / sigma_px
    weight = np.exp(-0.5 * x * x)
    weight /= weight.sum()
    return weight, weight * x, weight * x * x


def _transfer(kernel: Float64Array, reach: int, size: int) -> NDArray[np.complex64]:
    """Return the transfer function of a kernel, truncated at `reach`: complex64 array of shape (size,)."""
    centre = kernel.size // 2
    placed = np.zeros(size)
    placed[: reach + 1] = kernel[centre : centre + reach + 1]
    placed[size - reach :] = kernel[centre - reach : centre]
    # Conjugate: a sum around a pixel is a correlation, not a convolution.
    return np.conj(scipy.fft.fft(placed)).astype(np.complex64)


# The Gaussian profile filter (ISO 16610-21), of first order at ends and beside holes (ISO 16610-31).

_MIN_PROFILE_DETERMINANT = 1e-6


def profile_mean(z_um: Float64Array, cutoff_samples: float) -> Float64Array:
    """Return gaussian mean line of the valid samples: float64 array of shape (N,), NaN where `z_um` is NaN."""
    sigma = ALPHA * cutoff_samples / np.sqrt(2.0 * np.pi)
    reach = max(int(np.ceil(REACH * sigma)), 1)
    x = np.arange(-reach, reach + 1) / sigma
    weight = np.exp(-0.5 * x * x)
    weight /= weight.sum()
    valid = np.isfinite(z_um)
    if not valid.any():
        return z_um.copy()
    level = float(z_um[valid].mean())
    filled = np.where(valid, z_um - level, 0.0)

    def around(values: Float64Array, power: int) -> Float64Array:
        # Reversed, as the sum is taken around a sample.
        return np.asarray(fftconvolve(values, (weight * x**power)[::-1], mode="full")[reach : reach + values.size])

    ones = valid.astype(np.float64)
    n, first, second = (around(ones, power) for power in range(3))
    z0, z1 = (around(filled, power) for power in range(2))
    n = np.maximum(n, 1e-9)
    determinant = n * second - first * first
    spans = determinant > _MIN_PROFILE_DETERMINANT * n * n
    line = (z0 * second - z1 * first) / np.where(spans, determinant, 1.0)
    return np.where(valid, np.where(spans, line, z0 / n) + level, np.nan)
