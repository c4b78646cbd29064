"""The ball radius that shows in presses, where the stated one does not or none is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.balls.detector import find_balls
from device.errors import CalibrationError
from device.imaging.flat_field import NormalizedImage

RADII: Final = tuple(0.07 * 1.4**step for step in range(9))
"""Radii that are tried, fractions of the frame's shorter side."""

LOOKED_AT_PX: Final = 320
"""Frames are reduced to about this length of their shorter side."""


@dataclass(frozen=True, slots=True)
class FittingRadius:
    """The ball radius that shows in most of the presses that were looked at: pixels, and in how many of how many."""

    radius_px: float
    presses: int
    looked_at: int

    def sentence(self, pitch_um: float, stated_px: float) -> str:
        """Return the sentence that compares it with the stated radius."""
        return (
            f"balls of about {self.radius_px:.0f} px ({self.radius_px * pitch_um / 1e3:.2g} mm at {pitch_um:g} µm a "
            f"pixel) show in {self.presses} of {self.looked_at} presses, and {stated_px:.0f} px "
            f"({stated_px * pitch_um / 1e3:.3g} mm) is stated"
        )


def fitting_radius(images: Sequence[NormalizedImage]) -> FittingRadius | None:
    """Return the radius of the balls that show in frames, from their contacts; None where none shows.

    Contacts of one size fit balls of several radii: of those that show as often, the middle one is returned.
    """
    if not images:
        return None
    factor = max(1, min(images[0].shape) // LOOKED_AT_PX)
    small = [_reduced(image, factor) for image in images]
    counts = {}
    for fraction in RADII:
        radius_px = fraction * min(small[0].shape)
        counts[radius_px * factor] = sum(_shows(image, radius_px) for image in small)
    most = max(counts.values())
    best = [radius_px for radius_px, count in counts.items() if count == most]
    return FittingRadius(float(np.exp(np.mean(np.log(best)))), most, len(small)) if most else None


def _shows(image: NormalizedImage, radius_px: float) -> bool:
    """Return whether a ball of this radius is found; no radius is too large or small to be tried."""
    try:
        return bool(find_balls(image, radius_px).found)
    except CalibrationError:
        return False


def _reduced(image: NormalizedImage, factor: int) -> NormalizedImage:
    if factor == 1:
        return image
    size = (image.shape[1] // factor, image.shape[0] // factor)
    values = cv2.resize(image.values, size, interpolation=cv2.INTER_AREA)
    valid, clipped = (
        cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(np.bool_)
        for mask in (image.valid, image.clipped)
    )
    return NormalizedImage(np.asarray(values, np.float32), valid, clipped)
