"""A surface as a short row of numbers that do not change when the object is shifted or turned.

Heights are split into bands of an octave by differences of Gaussians (Burt and Adelson 1983, "The Laplacian pyramid
as a compact image code"). Each band gives its RMS slope, skewness, kurtosis and the coherence of its structure tensor
(Bigun and Granlund 1987), which says how far it has one direction, not which. The distributions of heights and of
slopes in contact complete the row. Widths are in mm of skin, so pixel pitches do not matter.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.errors import Indescribable
from host_sync.results.reader import ResultSurface

VERSION: Final = 1
"""Grows when a figure changes; an index of another version is rebuilt."""

PITCH_UM: Final = 48.0
"""Finer height maps are reduced to about this pitch."""

BANDS_MM: Final = (0.1, 0.2, 0.4, 0.8)
"""Standard deviations of the finer Gaussian of each band; the other's is twice as large."""

QUANTILES: Final = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
SLOPE_QUANTILES: Final = (0.25, 0.5, 0.75, 0.95)
CONTACT: Final = 0.15
"""What is higher than this part of the range above the lowest is taken as in contact."""

MIN_RANGE_UM: Final = 5.0
MIN_RANGE_SIGMAS: Final = 4.0
MIN_PIXELS: Final = 400
FLOOR_SLOPE: Final = 1e-3

LENGTH: Final = 4 * len(BANDS_MM) + len(QUANTILES) + len(SLOPE_QUANTILES) + 2


def describe_result(result: ResultSurface) -> Float32Array:
    """Return the descriptor of a result's height map; see `describe`."""
    sigma_um = result.sigma_um
    known = sigma_um[np.isfinite(sigma_um)] if sigma_um is not None else np.zeros(0, np.float32)
    return describe(result.height, float(np.median(known)) if known.size else 0.0)


def describe(height: HeightMap, sigma_um: float = 0.0) -> Float32Array:
    """Return the descriptor of a height map: float32 array of shape (LENGTH,), all finite.

    Amplitudes are decimal logarithms; rows are to be compared after `host_sync.likeness.search`.

    sigma_um : median standard uncertainty of a height, µm

    Raises
    ------
    Indescribable
        Nothing touches the skin, or too little is valid.
    """
    z_um, pitch_mm = _reduced(height)
    known = np.isfinite(z_um)
    if int(known.sum()) < MIN_PIXELS:
        raise Indescribable("too few heights are valid")
    low, high = (float(at) for at in np.percentile(z_um[known], (1.0, 99.0)))
    least_um = max(MIN_RANGE_UM, MIN_RANGE_SIGMAS * sigma_um)
    if high - low < least_um:
        raise Indescribable(
            f"no skin contact: heights range over {high - low:.1f} µm, contact shows from {least_um:.1f} µm"
        )
    contact = known & (z_um > low + CONTACT * (high - low))
    if int(contact.sum()) < MIN_PIXELS:
        raise Indescribable("too little of the skin is in contact")
    figures: list[float] = []
    fine = _blurred(z_um, BANDS_MM[0] / pitch_mm)
    slope = _steepness(fine, pitch_mm)
    for width_mm in BANDS_MM:
        wide = _blurred(z_um, 2.0 * width_mm / pitch_mm)
        figures += _band_figures(fine - wide, contact, pitch_mm)
        fine = wide
    heights = np.quantile(z_um[contact], QUANTILES)
    figures += [(float(at) - low) / (high - low) for at in heights]
    steep = slope[contact & np.isfinite(slope)]
    figures += [float(np.log10(at + FLOOR_SLOPE)) for at in np.quantile(steep, SLOPE_QUANTILES)]
    figures += [float(np.log10(high - low)), float(np.log10(contact.sum() * pitch_mm**2))]
    return np.asarray(figures, np.float32)


def _band_figures(band: Float32Array, contact: MaskArray, pitch_mm: float) -> list[float]:
    """Return the logarithm of the RMS slope, skewness, kurtosis and coherence of a band where the object touches."""
    down, across = (np.asarray(slope, np.float64) for slope in np.gradient(band * np.float32(1e-3 / pitch_mm)))
    inside = contact & np.isfinite(down) & np.isfinite(across)
    if int(inside.sum()) < MIN_PIXELS:
        raise Indescribable("the contact is too narrow")
    q, p = down[inside], across[inside]
    pp, qq, pq = float(np.mean(p * p)), float(np.mean(q * q)), float(np.mean(p * q))
    heights: Float64Array = band[inside].astype(np.float64)
    heights = heights - heights.mean()
    spread = max(float(heights.std()), 1e-9)
    return [
        float(np.log10(np.sqrt(pp + qq) + FLOOR_SLOPE)),
        float(np.arctan(np.mean(heights**3) / spread**3)),
        float(np.log10(max(float(np.mean(heights**4)) / spread**4, 1.0))),
        float(np.hypot(pp - qq, 2.0 * pq) / max(pp + qq, 1e-18)),
    ]


def _reduced(height: HeightMap) -> tuple[Float32Array, float]:
    """Return heights (µm) at about `PITCH_UM`, and their pitch, mm."""
    step = max(1, round(PITCH_UM / height.pitch_um))
    rows, columns = (size // step for size in height.z_um.shape)
    if step == 1 or min(rows, columns) < 1:
        return height.z_um, 1e-3 * height.pitch_um
    part = height.z_um[: rows * step, : columns * step]
    known = np.isfinite(part)
    total, share = (
        cv2.resize(field, (columns, rows), interpolation=cv2.INTER_AREA)
        for field in (np.where(known, part, np.float32(0.0)), known.astype(np.float32))
    )
    mean = np.where(share > 0.5, total / np.maximum(share, np.float32(1e-6)), np.float32(np.nan))
    return np.asarray(mean, np.float32), 1e-3 * height.pitch_um * step


def _blurred(values: Float32Array, width_px: float) -> Float32Array:
    """Return gaussian mean over the valid pixels, NaN at the others."""
    known = np.isfinite(values)
    share, total = (
        cv2.GaussianBlur(field, (0, 0), width_px)
        for field in (known.astype(np.float32), np.where(known, values, np.float32(0.0)))
    )
    mean = total / np.maximum(share, np.float32(1e-6))
    return np.asarray(np.where(known, mean, np.float32(np.nan)), np.float32)


def _steepness(z_um: Float32Array, pitch_mm: float) -> Float32Array:
    """Return the size of the slope, µm/µm."""
    down, across = np.gradient(z_um * np.float32(1e-3 / pitch_mm))
    return np.asarray(np.hypot(down, across), np.float32)
