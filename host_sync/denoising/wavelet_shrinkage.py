"""Wavelet shrinkage of an intensity image, written plainly; `shrinkage_kernel` does the same in one pass.

The image's root has shot noise of the same variance everywhere. An à-trous transform of it (Starck, Murtagh & Fadili,
"Sparse Image and Signal Processing", chapter 3; filter [1 2 1]/4, holes of 1, 2 and 4 pixels) leaves three planes of
detail and a smooth rest. A long wave leaks into all of them, into each a quarter of what it leaves in the next coarser
one; that share is taken out, so that what is shrunk of a finer plane costs no long wave. At each pixel the energy of
the three colours' detail, in units of its noise, or a share of that of the next coarser plane if that is more (what is
strong there goes on in finer planes), is averaged along five pixels in four directions; the largest of the four decides
how much of the detail is kept. A line keeps its energy along itself and survives, a speckle does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from device.surface.fields import Float32Array

LEVELS: Final = 3
REACH_PX: Final = 2
"""Pixels on either side of the one whose energy is averaged along a direction."""

DIRECTIONS: Final = ((0, 1), (1, 0), (1, 1), (1, -1))
"""(row, column) steps along which energy is averaged."""

HALO_PX: Final = (1 << LEVELS) - 1 + REACH_PX
"""How far around a pixel its shrunk value depends on the image."""

SPLIT_PX: Final = 8.0
"""Standard deviation of the Gaussian that parts fine from coarse: half of a sinusoid of 43 px is on either side.

The coarsest detail that is shrunk has periods of about 10 to 30 px.
"""

LEAK: Final = 0.25
"""Share of the next coarser plane in a plane, for long waves: both are second differences, over holes of half the
size."""

SHARES: Final = (1.0, 1.0 + LEAK, 1.0 + LEAK + LEAK**2)
"""What the detail planes are multiplied by before they are added to the smooth rest; sums to the image."""

PARENT_SHARE: Final = 0.1
"""Share of the next coarser plane's energy that speaks for detail of a plane.

Of a sinusoid of 20 px and 17° a rendered sensor keeps 0.98, as without shrinkage, instead of 0.957; untouched skin
is as quiet as without.
"""

MIN_ENERGY: Final = np.float32(1e-12)


@dataclass(frozen=True, slots=True, eq=False)
class Shrinkage:
    """How detail is shrunk.

    whitening : float32 array of shape (3, 3, 3), one upper-triangular matrix W a level: |W d|² / 3 averages 1 on noise
    threshold : float32 array of shape (3,), λ of each level: 1 - (λ / energy)² of the detail is kept
    kept : float32 array of shape (3,), share of each level's detail that is kept in any case
    """

    whitening: Float32Array
    threshold: Float32Array
    kept: Float32Array


def detail_planes(root: Float32Array, levels: int = LEVELS) -> tuple[list[Float32Array], Float32Array]:
    """Detail planes without leaks, finest first, and the smooth rest, of an image of shape (H, W, C); all of its shape.

    The coarsest plane keeps its leak. Up to 7 pixels from the border they are not those of a larger image.
    """
    details, smooth = [], root
    for level in range(levels):
        smoother = _smoothed(_smoothed(smooth, 1 << level, 0), 1 << level, 1)
        details.append(smooth - smoother)
        smooth = smoother
    for fine, coarse in pairwise(details):
        fine -= np.float32(LEAK) * coarse
    return details, smooth


def noise_energy(detail: Float32Array, whitening: Float32Array) -> Float32Array:
    """Energy of the three colours' detail in units of the noise: float32 array of shape (H, W)."""
    whitened = detail @ whitening.T
    return np.asarray((whitened * whitened).sum(axis=-1) / np.float32(3.0), np.float32)


def with_parent(energy: Float32Array, coarser: Float32Array) -> Float32Array:
    """What speaks for a plane's detail: its energy or a share of the next coarser plane's, of the same shape."""
    return np.asarray(np.maximum(energy, np.float32(PARENT_SHARE) * coarser), np.float32)


def directional_energy(energy: Float32Array) -> Float32Array:
    """The largest mean of energy along five pixels in four directions: float32 array of the shape of `energy`."""
    best = np.full(energy.shape, MIN_ENERGY, np.float32)
    for down, across in DIRECTIONS:
        total = energy.copy()
        for step in range(1, REACH_PX + 1):
            total += _moved(energy, step * down, step * across) + _moved(energy, -step * down, -step * across)
        best = np.maximum(best, total * np.float32(1.0 / (2 * REACH_PX + 1)))
    return best


def _smoothed(image: Float32Array, hole: int, axis: int) -> Float32Array:
    size = image.shape[axis]
    before, after = (np.take(image, [edge], axis=axis).repeat(hole, axis=axis) for edge in (0, -1))
    padded = np.concatenate([before, image, after], axis=axis)
    ahead, behind = (padded[(slice(None),) * axis + (slice(at, at + size),)] for at in (2 * hole, 0))
    around = ahead + behind
    around *= np.float32(0.25)
    around += np.float32(0.5) * image
    return np.asarray(around, np.float32)


def _moved(image: Any, down: int, across: int) -> Any:
    """The image moved by whole pixels; beyond the border the outermost pixels repeat."""
    rows = np.clip(np.arange(image.shape[0]) + down, 0, image.shape[0] - 1)
    columns = np.clip(np.arange(image.shape[1]) + across, 0, image.shape[1] - 1)
    return image[rows][:, columns]
