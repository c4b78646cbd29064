"""How strongly a calibration's frames are shrunk: as the recipe says, or less where that would cost fine detail.

Held-out balls are smooth and always ask for more; so what bounds the strength is what is left of fine patterns at the
calibration's own noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float32Array
from host_sync.denoising.detail_transfer import DetailTransfer, TransferBench
from host_sync.denoising.frame_noise import FrameNoise, measure_noise
from host_sync.denoising.long_waves import shrink_but_long_waves
from host_sync.denoising.slope_colour import SlopeColour
from host_sync.denoising.wavelet_shrinkage import Shrinkage

THRESHOLD: Final = (1.1, 2.2, 2.2)
"""λ of each level at full strength."""

FINEST_KEPT: Final = 0.6
"""Share of the finest detail that is kept in any case, at full strength: integration removes the rest of its noise."""

STRENGTHS: Final = (1.0, 0.75, 0.5, 0.25)
BOUND_DEG: Final = 9.0
BOUND_PX: Final = 4.0
MIN_KEPT: Final = 0.6
"""Of a sinusoid of that tilt and wavelength."""

WIDEST_RIDGE_PX: Final = 2.0
"""Of a ridge of one pixel and that tilt."""


@dataclass(frozen=True, slots=True, eq=False)
class DetailShrinkage:
    """What a calibration knows of its noise and of shrinking it.

    noise : of its frames
    strength : share of the recipe's strength
    shrinkage : as the kernel takes it
    transfer : what is left of fine patterns
    """

    noise: FrameNoise
    strength: float
    shrinkage: Shrinkage
    transfer: DetailTransfer

    def shrunk(self, image: NormalizedImage) -> NormalizedImage:
        """The image with its noise shrunk."""
        return shrink_but_long_waves(image, self.shrinkage)

    def record(self) -> dict[str, Any]:
        """What the calibration report says."""
        return {
            "strength": self.strength,
            "noise_covariance": [[float(value) for value in row] for row in self.noise.covariance],
            "noise_variance_by_level": [float(ratio) for ratio in self.noise.ratios],
            "transfer": self.transfer,
        }


def learn_shrinkage(
    pressed: Sequence[tuple[NormalizedImage, Sequence[Ball]]],
    samples: BallSamples,
    untouched: Sequence[Float32Array],
) -> DetailShrinkage | None:
    """The strongest allowed shrinkage of a calibration's frames; None where their noise cannot be told.

    pressed : intensity and balls of each press
    samples : of these balls
    untouched : as for `measure_noise`
    """
    noise = measure_noise(pressed, untouched)
    if noise is None:
        return None
    bench = TransferBench(SlopeColour.of(samples, pressed[0][0].shape), noise)
    for strength in STRENGTHS:
        shrinkage = shrinkage_of(noise, strength)
        transfer = bench.measure(shrinkage)
        if keeps_detail(transfer):
            return DetailShrinkage(noise, strength, shrinkage, transfer)
    return None


def shrinkage_of(noise: FrameNoise, strength: float) -> Shrinkage:
    """The shrinkage of a noise by a share of the recipe's strength."""
    kept = (1.0 - strength * (1.0 - FINEST_KEPT), 0.0, 0.0)
    return noise.shrinkage([strength * threshold for threshold in THRESHOLD], kept)


def keeps_detail(transfer: DetailTransfer) -> bool:
    """Whether a transfer keeps what shrinkage may not cost."""
    ridge_px = transfer.ridge_px[transfer.amplitude_deg.index(BOUND_DEG)]
    widest_px = max(WIDEST_RIDGE_PX, transfer.raw_ridge_px)
    return bool(np.isfinite(ridge_px) and ridge_px <= widest_px and transfer.at(BOUND_DEG, BOUND_PX) >= MIN_KEPT)
