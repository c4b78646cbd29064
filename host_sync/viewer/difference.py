"""The difference of two presses, and whether they show one thing at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.surface import Float32Array
from host_sync.viewer.resampling import reduced

FIT_PX: Final = 1024
SMOOTHED_PX: Final = 2.0
LEAST_AGREEMENT: Final = 0.6
"""Slopes, smoothed so that pixel noise does not count, correlate more than this where two presses show one thing: 0.99
with 1 µm of noise. Unrelated textures, laid on each other as well as can be, reach 0.35; fields of three or four broad
hills, of which nobody could say more, 0.65."""


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """The second height map minus the first, on the grid of the first.

    z_um : float32 array of shape (H, W), NaN where either is invalid
    shift_um : (rows, columns) by which the second shows the same thing further down and to the right, at the centre
    turn_deg : by which it shows it turned, clockwise on the screen
    offset_um, tilt : height (µm) and tilt (rows, columns; µm/µm) that were taken off
    residual_um : root mean square of what remains
    median_um : median of its size, which a few strangers do not move
    overlap_share : the common field as a share of the first map
    agreement : correlation of the slopes of both over the common field, 1 for the same thing without noise
    sigma_um : float32 array of shape (H, W), standard uncertainty of both together; None where one states none
    """

    z_um: Float32Array
    shift_um: tuple[float, float]
    turn_deg: float
    offset_um: float
    tilt: tuple[float, float]
    residual_um: float
    median_um: float
    overlap_share: float
    agreement: float
    sigma_um: Float32Array | None

    @property
    def doubt(self) -> str:
        """What speaks against the two showing one thing, or an empty text."""
        if self.agreement >= LEAST_AGREEMENT:
            return ""
        return (
            f"their slopes agree by {100.0 * max(self.agreement, 0.0):.0f} % only (one thing seen twice: over "
            f"{100.0 * LEAST_AGREEMENT:.0f} %): "
            "they may show different things, and the difference says nothing then"
        )


def slope_agreement(first: Float32Array, moved: Float32Array) -> float:
    """Correlation of the slopes of two maps that lie on each other; nought where either has none."""
    step = max(1, int(np.ceil(max(first.shape) / FIT_PX)))
    slopes = []
    for z_um in (first, moved):
        small = cv2.GaussianBlur(reduced(z_um, step), (0, 0), SMOOTHED_PX)
        q, p = np.gradient(small)
        slopes.append(p + 1j * q)
    known = np.isfinite(slopes[0]) & np.isfinite(slopes[1])
    one, other = (found[known] - found[known].mean() for found in slopes)
    size = float(np.sqrt((np.abs(one) ** 2).sum() * (np.abs(other) ** 2).sum()))
    return float(np.real(np.vdot(one, other))) / size if size > 0.0 else 0.0
