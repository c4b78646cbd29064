"""Response of a difference of heights to a round change of one width, as the height that it would have.

A reconstruction integrates slopes. Slopes that err alike at all wavelengths give heights whose error grows with the
wavelength, and errors in patches add to that. The filter is that of a Gaussian for such errors: its spectrum times the
third power of the wave number k.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, MaskArray

POWER: Final = 1.5
"""The spectrum of the Gaussian is multiplied by (k²) to this power."""

BACKGROUND_PX: Final = 30.0
"""Standard deviation of the Gaussian mean that is taken off first, so that the border of the valid field is no edge."""

REACH: Final = 2.0
"""A place is judged by a Gaussian of so many widths around it …"""

MIN_FILLED: Final = 0.85
"""… of which at least this part is valid."""

PADDING_PX: Final = 64


def blurred(values: Float32Array, scale_px: float) -> tuple[Float32Array, Float32Array]:
    """Gaussian mean over the valid pixels, and how much of the Gaussian is valid: arrays of shape (h, w)."""
    known = np.isfinite(values)
    share = _filled(known, scale_px)
    total = cv2.GaussianBlur(np.where(known, values, np.float32(0.0)), (0, 0), scale_px, borderType=cv2.BORDER_CONSTANT)
    mean = np.where(known, total / np.maximum(share, np.float32(1e-6)), np.float32(np.nan))
    return np.asarray(mean, np.float32), share


def heights(values: Float32Array, width_px: float) -> Float32Array:
    """The height of a round change at each place: float32 array of shape (h, w), NaN where too little is valid around.

    values : float32 array of shape (h, w), difference of heights, NaN where unknown
    width_px : standard deviation of the change's Gaussian
    """
    rest = np.nan_to_num(values - blurred(values, BACKGROUND_PX)[0])
    rows, columns = rest.shape
    padded = np.pad(rest, PADDING_PX)
    down = 2.0 * np.pi * np.fft.fftfreq(padded.shape[0])
    right = 2.0 * np.pi * np.fft.rfftfreq(padded.shape[1])
    square = down[:, None] ** 2 + right[None, :] ** 2
    profile = np.exp(-0.5 * square * width_px**2)
    answer = profile * square**POWER
    found = np.fft.irfft2(np.fft.rfft2(padded) * answer, s=padded.shape)
    found = found[PADDING_PX : PADDING_PX + rows, PADDING_PX : PADDING_PX + columns] / _of_one(width_px)
    judged = _filled(np.isfinite(values), REACH * width_px) > MIN_FILLED
    return np.asarray(np.where(judged & np.isfinite(values), found, np.nan), np.float32)


def _of_one(width_px: float) -> float:
    """The filter's answer in the middle of a Gaussian of height 1 and that width.

    It is the integral of 2π width² exp(-k² width²) k³ over the plane of k, over (2π)²: Γ(5/2) / (2 width³).
    """
    return 0.375 * float(np.sqrt(np.pi)) / width_px**3


def _filled(known: MaskArray, scale_px: float) -> Float32Array:
    """Return how much of a Gaussian around each place is valid: float32 array of shape (h, w)."""
    share = cv2.GaussianBlur(known.astype(np.float32), (0, 0), scale_px, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(share, np.float32)
