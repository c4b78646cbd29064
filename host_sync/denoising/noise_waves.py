"""Long waves of a height map that are noise: taken out where a frame shows nothing else.

Integration turns noise of slopes into long waves, 1 to 2.5 µm of them on a frame of untouched skin. How strong noise is
each frame shows itself: slopes are a part that belongs to a surface and one that belongs to none, their curl, and white
noise has the same power in both. An object's surface has ten to a hundred thousand times as much in every octave of
waves. Where none of them has, and no patch stands out once such waves are gone, they are noise. Longer waves are few
and hold what is misread of untouched skin: each is kept as far as it rises above noise.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from scipy.fft import dct, dctn, dst, idctn

from device.surface.fields import Float32Array, GradientField, HeightMap
from host_sync.integration.datum import cell_sums

MIN_CELL_PX: Final = 4
WIDEST_CELLS: Final = 512
"""Cells along the field's columns, at most."""

SHORTEST_CELLS: Final = 7.0
"""Period of the shortest waves that are looked at."""

MIN_WAVES: Final = 100
"""Of an octave that tells whether something is there."""

MAX_POWER: Final = 1.5
"""Power of a surface's slopes over that of their curl, in an octave, up to which all of it may be noise; 1 is expected.

Twelve rendered benches showed 0.9 to 1.3 of untouched skin, and 3.6 at least of any object."""

TILT_POWER: Final = 12.0
BOWL_POWER: Final = 36.0
"""Power of a longer wave over noise's: 1 - (this / power)² of it is kept, nothing where that is negative. The second
counts for waves that are even along both sides: lights stand around the field, so that what is misread of untouched
skin is a bowl. The benches showed 12 of the former at most, 31 of the latter."""

PATCH_SIGMAS: Final = 8.0
PATCH_CELLS: Final = 9
"""So many cells side by side that stand out of the rest by so much, in units of its spread, are no noise."""


def without_noise_waves(height: HeightMap, gradients: GradientField) -> tuple[HeightMap, float | None]:
    """The height map (H, W) of these slopes less its long waves, and an octave's largest power over that of noise; the
    same height map and None where something is there.

    Pixels without a height stay without one.
    """
    rows, columns = height.z_um.shape
    cell = max(MIN_CELL_PX, -(-columns // WIDEST_CELLS))
    p_sum, q_sum, count = cell_sums(gradients.p, gradients.q, gradients.valid, cell)
    surface, curl = _powers(*(_means(part, count) for part in (p_sum, q_sum)))
    frequency = np.hypot(*_frequencies(surface.shape))
    powers, lowest, noise = _by_octave(surface, curl, frequency)
    largest = max(powers, default=np.inf)
    if largest > MAX_POWER:
        return height, None
    taken = (frequency < 1.0 / SHORTEST_CELLS).astype(np.float32)
    long = frequency < lowest
    odd = np.logical_or(*(number % 2 == 1 for number in np.ogrid[: surface.shape[0], : surface.shape[1]]))
    limit = np.where(odd, np.float32(TILT_POWER), np.float32(BOWL_POWER))
    taken[long] = (
        np.minimum(limit[long] * noise, surface[long]) ** 2 / np.maximum(surface[long], np.float32(1e-15)) ** 2
    )
    cells_um = _cell_means(height.z_um, cell)
    noise_um = np.asarray(idctn(dctn(cells_um, norm="ortho") * taken, norm="ortho"), np.float32)
    if _has_patch(cells_um - noise_um):
        return height, None
    whole_um = cv2.resize(noise_um, (count.shape[1] * cell, count.shape[0] * cell), interpolation=cv2.INTER_LINEAR)
    return HeightMap(height.z_um - whole_um[:rows, :columns], height.pitch_um), largest


def _powers(p: Float32Array, q: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Power of waves of slopes (h, w) that belong to a surface, and of their curl: float32 arrays of shape (h, w).

    A surface with free borders is a sum of cosines; its slopes are sines along their own axis, cosines across.
    """
    along_p, along_q = np.zeros_like(p), np.zeros_like(q)
    along_p[:, 1:] = dct(dst(p, axis=1, norm="ortho"), axis=0, norm="ortho")[:, :-1]
    along_q[1:] = dct(dst(q, axis=0, norm="ortho"), axis=1, norm="ortho")[:-1]
    across, down = _frequencies(p.shape)
    length = np.maximum(np.hypot(across, down), np.float32(1e-9))
    surface, curl = (across * along_p + down * along_q) / length, (down * along_p - across * along_q) / length
    return np.asarray(surface**2, np.float32), np.asarray(curl**2, np.float32)


def _frequencies(shape: tuple[int, ...]) -> tuple[Float32Array, Float32Array]:
    """Periods a cell of cosines along columns and rows, float32 arrays of shape (1, w) and (h, 1)."""
    down, across = (np.arange(size, dtype=np.float32) / np.float32(2 * size) for size in shape)
    return across[None, :], down[:, None]


def _by_octave(surface: Float32Array, curl: Float32Array, frequency: Float32Array) -> tuple[list[float], float, float]:
    """Power of a surface over that of its curl in octaves of waves, the lowest frequency of the last octave, and what
    a wave of noise has there.
    """
    has_both = np.ones(curl.shape, np.bool_)
    has_both[0], has_both[:, 0] = False, False
    powers: list[float] = []
    top, noise = 1.0 / SHORTEST_CELLS, 0.0
    while True:
        octave = (frequency < top) & (frequency >= 0.5 * top)
        belongs_to_none = curl[octave & has_both]
        if belongs_to_none.size < MIN_WAVES:
            return powers, top, noise
        noise = float(belongs_to_none.mean())
        powers.append(float(surface[octave].mean()) / max(noise, 1e-30))
        top *= 0.5


def _cell_means(z_um: Float32Array, cell: int) -> Float32Array:
    """Mean heights of cells of `cell` x `cell` pixels, less the mean of all; zero where none is known."""
    known = np.isfinite(z_um)
    total, _, count = cell_sums(z_um, z_um, known, cell)
    mean_um = np.float32(total.sum(dtype=np.float64) / max(count.sum(dtype=np.float64), 1.0))
    return np.where(count > 0.0, _means(total, count) - mean_um, np.float32(0.0))


def _means(total: Float32Array, count: Float32Array) -> Float32Array:
    """Means of cells, float32 array of shape (h, w), from their sums; zero where a cell holds nothing."""
    return np.asarray(total / np.maximum(count, np.float32(1.0)), np.float32)


def _has_patch(cells_um: Float32Array) -> bool:
    """Whether some cells side by side stand out."""
    apart = np.abs(cells_um - np.median(cells_um))
    out = apart > PATCH_SIGMAS * 1.4826 * np.median(apart)
    parts = cv2.connectedComponentsWithStats(out.astype(np.uint8), connectivity=8)[2]
    return bool((parts[1:, cv2.CC_STAT_AREA] >= PATCH_CELLS).any())
