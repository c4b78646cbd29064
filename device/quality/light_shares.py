"""Fractions of the intensity of untouched skin that come from each light, measured with each light alone.

Colour filters overlap, and near lights reach a field unevenly: in the corner that is farthest from the blue light,
little more than half of the blue channel is that light's. There its loss of 2 % shows as 1 %. With each light's share w
of each channel c in each block b of the field, the levels f of the lights follow from the channels' intensities,

    r_c(b) = Σ_k f_k w_ck(b),        Σ_k w_ck(b) = 1,

three equations for three lights in every block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.surface import Float32Array, Float64Array, MaskArray

MAX_RESIDUAL: Final = 0.012
"""Largest rms disagreement between the lights alone and the reference, relative; pressed skin disagrees by more."""

NOISE_FLOOR: Final = 0.02
NOISIER: Final = 6.0
"""A block contradicts if a channel is off by more than NOISIER times the median block, or than NOISE_FLOOR."""

MAX_DUSTY: Final = 0.1
DUST_PASSES: Final = 3
EQUALLY: Final = 0.4
"""Dust and scratches darken a block under every light alike: its channels differ by at most EQUALLY of their mean loss.
Such blocks are left out, with neighbours that are nowhere brighter, in at most MAX_DUSTY of the field. Whatever else
contradicts is an object in contact."""

MIN_LEVEL: Final = 0.1
"""A light below this fraction of its calibrated level is out: its shares cannot be measured."""


@dataclass(frozen=True, slots=True, eq=False)
class LightShares:
    """Shares of the lights in the channels of untouched skin.

    shares : float32 array of shape (rows, columns of blocks, 3 channels, 3 lights); over the lights they add up to 1
    """

    shares: Float32Array

    @classmethod
    def measure(cls, alone: Sequence[Float32Array], dark: Float32Array) -> LightShares | None:
        """Return the shares from frames of untouched skin under each light alone, in R, G, B order, and under none.

        alone, dark : the blocks' light relative to the reference, float32 arrays of shape (rows, columns, 3). None if
            no levels of the lights explain the reference, because something touches the skin or a light is out.
        """
        lit = np.stack([light - dark for light in alone], axis=-1)
        design = lit.reshape(-1, lit.shape[-1]).astype(np.float64)
        target = (1.0 - dark).ravel().astype(np.float64)
        kept, fine = np.ones(lit.shape[:2], np.bool_), False
        for _ in range(DUST_PASSES):
            used = kept.ravel().repeat(3)
            inverse_levels, *_ = np.linalg.lstsq(design[used], target[used], rcond=None)
            excess = (design @ inverse_levels - target).reshape(*lit.shape[:2], 3)
            kept, fine = _without_dust(excess)
        residual = float(np.sqrt(np.mean(excess[kept] ** 2)))
        if not fine or (~kept).mean() > MAX_DUSTY:
            return None
        if residual > MAX_RESIDUAL or not (inverse_levels > 0.0).all() or (inverse_levels > 1.0 / MIN_LEVEL).any():
            return None
        calibrated = lit * inverse_levels
        return cls(np.asarray(calibrated / calibrated.sum(axis=-1, keepdims=True), np.float32))

    @classmethod
    def by_channel(cls) -> LightShares:
        """Return the shares when each channel shows its own light alone, everywhere."""
        return cls(np.eye(3, dtype=np.float32)[None, None])

    def levels(self, ratio: Float32Array) -> Float32Array:
        """Return the level of each light in each block, float32 array of shape (rows, columns, 3), 1 as calibrated.

        ratio : the blocks' intensity relative to the reference, of that shape; on untouched skin every block then shows
            the same levels
        """
        return np.asarray(np.linalg.solve(self.shares, ratio[..., None])[..., 0], np.float32)

    def channels(self, levels: Sequence[float]) -> tuple[float, float, float]:
        """Return the mean intensity of untouched skin in R, G and B under these levels of the lights."""
        red, green, blue = (float(value) for value in self.shares.mean(axis=(0, 1)) @ np.asarray(levels))
        return red, green, blue


def _without_dust(excess: Float64Array) -> tuple[MaskArray, bool]:
    """Return blocks without dust, bool array of shape (rows, columns), and whether none of them contradicts.

    excess : the blocks' light over what the levels explain, relative, float64 array of shape (rows, columns, 3)
    """
    limit = max(NOISE_FLOOR, NOISIER * float(np.median(np.abs(excess).max(axis=-1))))
    loss, spread = -excess.mean(axis=-1), np.ptp(excess, axis=-1)
    dust = (excess < -limit / 2.0).all(axis=-1) & (loss > limit) & (spread < EQUALLY * loss + limit / 2.0)
    beside = cv2.dilate(dust.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    off = np.abs(excess).max(axis=-1) > limit
    kept = ~(dust | (beside & off & (excess < limit).all(axis=-1)))
    return np.asarray(kept, np.bool_), not (off & kept).any()
