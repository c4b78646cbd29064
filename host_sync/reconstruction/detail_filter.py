"""Detail of a height map: what lies between an S-filter and an L-filter (paper, section 6.1; ISO 16610-61).

Both are areal Gaussian filters, s(x, y) = exp(-π (x² + y²) / (α λ)²) / (α λ)² with α = √(ln 2 / π), which pass one half
of a sinusoid whose period is the nesting index λ. The S-filter takes away what is shorter, the L-filter what is longer:
detail = S-filtered surface less its L-filtered mean.

Why a local plane: at borders and beside holes half of the weights are missing, and a mean of what is left bends every
slope. So the mean is the value of the plane that fits the valid pixels under the weights best (regression of first
order, as in ISO 16610-31): a tilt passes unchanged everywhere, and where nothing is missing that value is the mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap
from host_sync.errors import FilterError

ALPHA: Final = float(np.sqrt(np.log(2.0) / np.pi))
REACH: Final = 4.0
"""The weights reach this many standard deviations."""

_LEAST_DETERMINANT: Final = 1e-4
"""Normalised determinant under which the pixels near a place span no plane: their mean serves."""


@dataclass(frozen=True, slots=True)
class DetailBand:
    """Nesting indices, µm; None leaves the filter out.

    Raises
    ------
    FilterError
        An index is not a positive length, or the S-filter takes away what the L-filter leaves.
    """

    s_um: float | None
    l_um: float | None

    def __post_init__(self) -> None:
        for name, index_um in (("S", self.s_um), ("L", self.l_um)):
            if index_um is not None and not 0.0 < index_um < float("inf"):
                raise FilterError(f"the {name}-filter's nesting index is {index_um:g} µm: give a positive length")
        if self.s_um is not None and self.l_um is not None and self.s_um >= self.l_um:
            raise FilterError(
                f"the S-filter at {self.s_um:g} µm takes away all that the L-filter at {self.l_um:g} µm leaves: "
                "give it the smaller nesting index"
            )


def detail(height: HeightMap, band: DetailBand) -> HeightMap:
    """The height map between the band's nesting indices, NaN where the height map has none."""
    z_um = height.z_um if band.s_um is None else gaussian_mean(height.z_um, band.s_um / height.pitch_um)
    if band.l_um is not None:
        z_um = z_um - gaussian_mean(z_um, band.l_um / height.pitch_um)
    return HeightMap(z_um, height.pitch_um)


def gaussian_mean(z: Float32Array, cutoff_px: float) -> Float32Array:
    """Gaussian mean of the valid pixels with a cut-off in pixels: float32 array (H, W), NaN where `z` is NaN."""
    valid = np.isfinite(z)
    if not valid.any():
        return z
    # Heights about their own mean: float32 then holds them to a thousandth of the relief, however high it lies.
    level = float(z[valid].mean())
    filled = np.where(valid, z - np.float32(level), np.float32(0.0))
    kernels = _kernels(cutoff_px)
    z0, zx, zy = (_convolved(filled, kernels, across, down) for across, down in ((0, 0), (1, 0), (0, 1)))
    mean = _plane(valid.astype(np.float32), (z0, zx, zy), kernels)
    return np.where(valid, mean + np.float32(level), np.float32(np.nan)).astype(np.float32)


def _kernels(cutoff_px: float) -> tuple[Float64Array, ...]:
    """Gaussian weights along one axis, and the same times x and x²; x in standard deviations."""
    sigma_px = ALPHA * cutoff_px / np.sqrt(2.0 * np.pi)
    reach = max(int(np.ceil(REACH * sigma_px)), 1)
    x = np.arange(-reach, reach + 1) / sigma_px
    weight = np.exp(-0.5 * x * x)
    weight /= weight.sum()
    return weight, weight * x, weight * x * x


def _convolved(values: Float32Array, kernels: tuple[Float64Array, ...], across: int, down: int) -> Float32Array:
    """Sum of values times weight times x^across y^down around each pixel; nothing lies beyond the border."""
    summed = cv2.sepFilter2D(values, cv2.CV_32F, kernels[across], kernels[down], borderType=cv2.BORDER_CONSTANT)
    return np.asarray(summed, np.float32)


def _plane(weight: Float32Array, sums: tuple[Float32Array, ...], kernels: tuple[Float64Array, ...]) -> Float32Array:
    """Value at each pixel of the plane that fits the weighted pixels around it: float32 array (H, W)."""
    z0, zx, zy = sums
    n = np.maximum(_convolved(weight, kernels, 0, 0), np.float32(1e-6))
    x, y = _convolved(weight, kernels, 1, 0), _convolved(weight, kernels, 0, 1)
    xx, xy, yy = (_convolved(weight, kernels, i, j) for i, j in ((2, 0), (1, 1), (0, 2)))
    by_n, by_x, by_y = xx * yy - xy * xy, xy * y - x * yy, x * xy - xx * y
    determinant = n * by_n + x * by_x + y * by_y
    spans = determinant > _LEAST_DETERMINANT * n**3
    value = (z0 * by_n + zx * by_x + zy * by_y) / np.where(spans, determinant, np.float32(1.0))
    return np.where(spans, value, z0 / n).astype(np.float32)
