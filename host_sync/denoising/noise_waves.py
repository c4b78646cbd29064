"""Long waves of a height map that are noise: taken out where a frame shows nothing else.

Integration turns noise of slopes into long waves, 1 to 2.5 µm of them on a frame of untouched skin. How strong noise is
each frame shows itself: slopes are a part that belongs to a surface and one that belongs to none, their curl, and white
noise has the same power in both. An octave of waves shows something where the surface's power over a patch exceeds what
curl shows over patches of that size. Where no octave does at any place, its waves are noise. Longer waves are few and
hold what is misread of untouched skin: each is kept as far as it rises above noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.fft import dct, dctn, dst, idctn

from device.surface.fields import Float32Array, GradientField, HeightMap, MaskArray
from host_sync.integration.datum import cell_sums

MIN_CELL_PX: Final = 4
WIDEST_CELLS: Final = 512
"""Cells along the field's longer side, at most."""

SHORTEST_CELLS: Final = 7.0
"""Period of the shortest waves that are taken out."""

MIN_WAVES: Final = 25
"""Of an octave that is asked whether something is there."""

PATCH_PERIODS: Final = 0.35
"""Standard deviation of the Gaussian over a patch, in the longest period of its octave."""

AROUND: Final = 3.0
"""Standard deviation of the Gaussian over which curl shows how loud noise is there, in those of a patch."""

CLEAR_POWER: Final = (6.0, 9.0)
"""Largest power of a surface over a patch, over that of curl around there: up to the first all may be noise, from the
second on nothing is taken out. Untouched skin of twelve rendered benches showed 2.0 to 5.4."""

MAX_POWER: Final = 2.0
"""The same of all of an octave on the mean, from which on no patch needs to be looked at."""

TILT_POWER: Final = 12.0
BOWL_POWER: Final = 36.0
"""Power of a longer wave over noise's: 1 - (this / power)² of it is kept, nothing where that is negative. The second
counts for waves of one period along one side: lights stand around the field, so that what is misread of untouched skin
is a bowl. Twelve rendered benches showed 12 of the former at most, 31 of the latter."""

DOUBT: Final = 1.0 / 3.0
"""Standard uncertainty of what is taken out, as a share: something faint may have been there."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseWaves:
    """What was taken out of a height map.

    taken_um : float32 array of shape (H, W)
    power : largest power of a surface over a patch, over that of curl around it
    left : root mean square of what is left, as a share of what there was
    """

    taken_um: Float32Array
    power: float
    left: float

    def off(self, height: HeightMap) -> HeightMap:
        """The height map without them."""
        return HeightMap(height.z_um - self.taken_um, height.pitch_um)

    def doubted(self, sigma_um: Float32Array, samples_um: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Standard uncertainty (H, W) and samples (K, h, w) of the height without them, from those with them."""
        some = cv2.resize(self.taken_um, samples_um.shape[:0:-1], interpolation=cv2.INTER_AREA)
        normal = np.random.default_rng(0).standard_normal((len(samples_um), 1, 1)).astype(np.float32)
        left, doubt = np.float32(self.left), np.float32(DOUBT)
        return np.hypot(left * sigma_um, doubt * self.taken_um), left * samples_um + doubt * normal * some


def noise_waves(height: HeightMap, gradients: GradientField) -> NoiseWaves | None:
    """Waves of the height map (H, W) of these slopes that are noise; None where something is there."""
    cell = max(MIN_CELL_PX, -(-max(height.z_um.shape) // WIDEST_CELLS))
    p_sum, q_sum, count = cell_sums(gradients.p, gradients.q, gradients.valid, cell)
    # Cells of fewer pixels, which are noisier, count for as much less.
    share = np.asarray(np.sqrt(count) / np.float32(cell), np.float32)
    surface, curl = _waves(share * _means(p_sum, count), share * _means(q_sum, count))
    frequency = np.hypot(*_frequencies(count.shape))
    octaves = list(_octaves(curl, frequency))
    if not octaves or max(float((surface[one] ** 2).mean() / _mean_square(curl[one])) for one in octaves) > MAX_POWER:
        return None
    power = max(_largest_power(surface, curl, one, frequency, count > 0.0) for one in octaves)
    taken_share = float(np.clip((CLEAR_POWER[1] - power) / (CLEAR_POWER[1] - CLEAR_POWER[0]), 0.0, 1.0))
    if taken_share == 0.0:
        return None
    lowest, noise = float(frequency[octaves[-1]].min()), _mean_square(curl[octaves[-1]])
    taken = (frequency < 1.0 / SHORTEST_CELLS).astype(np.float32)
    long = frequency < lowest
    limit = np.full(count.shape, np.float32(TILT_POWER))
    limit[0, 2:3], limit[2:3, 0] = BOWL_POWER, BOWL_POWER
    square = np.maximum(surface[long] ** 2, np.float32(1e-15))
    taken[long] = np.minimum(1.0, limit[long] * noise / square) ** 2
    cells_um = _cell_means(height.z_um, cell)
    waves_um = np.asarray(idctn(dctn(cells_um, norm="ortho") * (taken_share * taken), norm="ortho"), np.float32)
    left = float(np.std(cells_um - waves_um) / max(float(np.std(cells_um)), 1e-12))
    whole = (count.shape[1] * cell, count.shape[0] * cell)
    taken_um = cv2.resize(waves_um, whole, interpolation=cv2.INTER_LINEAR)
    rows, columns = height.z_um.shape
    return NoiseWaves(np.ascontiguousarray(taken_um[:rows, :columns]), power, min(left, 1.0))


def _waves(p: Float32Array, q: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Waves of slopes (h, w) that belong to a surface, and of their curl: amplitudes, float32 arrays of shape (h, w).

    A surface with free borders is a sum of cosines; its slopes are sines along their own axis, cosines across.
    """
    along_p, along_q = np.zeros_like(p), np.zeros_like(q)
    along_p[:, 1:] = dct(dst(p, axis=1, norm="ortho"), axis=0, norm="ortho")[:, :-1]
    along_q[1:] = dct(dst(q, axis=0, norm="ortho"), axis=1, norm="ortho")[:-1]
    across, down = _frequencies(p.shape)
    length = np.maximum(np.hypot(across, down), np.float32(1e-9))
    surface, curl = (across * along_p + down * along_q) / length, (down * along_p - across * along_q) / length
    return np.asarray(surface, np.float32), np.asarray(curl, np.float32)


def _frequencies(shape: tuple[int, ...]) -> tuple[Float32Array, Float32Array]:
    """Periods a cell of cosines along columns and rows, float32 arrays of shape (1, w) and (h, 1)."""
    down, across = (np.arange(size, dtype=np.float32) / np.float32(2 * size) for size in shape)
    return across[None, :], down[:, None]


def _octaves(curl: Float32Array, frequency: Float32Array) -> Iterator[MaskArray]:
    """Which waves (h, w) are of each octave that holds enough of them, the finest first."""
    top = 0.25
    while np.count_nonzero(curl[octave := (frequency < top) & (frequency >= 0.5 * top)]) >= MIN_WAVES:
        yield octave
        top *= 0.5


def _largest_power(
    surface: Float32Array, curl: Float32Array, octave: MaskArray, frequency: Float32Array, known: MaskArray
) -> float:
    """Power of a surface over a patch over that of curl around it, at least curl's median, where that is largest."""
    sigma = PATCH_PERIODS / float(frequency[octave].min())
    ours, null = (
        cv2.GaussianBlur(np.asarray(idctn(part * octave, norm="ortho"), np.float32) ** 2, (0, 0), sigma)
        for part in (surface, curl)
    )
    around = cv2.GaussianBlur(null, (0, 0), AROUND * sigma)
    usual = np.float32(max(float(np.median(null[known])), 1e-30))
    return float((ours / np.maximum(around, usual)).max())


def _mean_square(curl: Float32Array) -> float:
    """Mean power of the waves that have a curl; those along one axis have none."""
    return max(float((curl**2).sum()) / max(int(np.count_nonzero(curl)), 1), 1e-30)


def _cell_means(z_um: Float32Array, cell: int) -> Float32Array:
    """Mean heights of cells of `cell` x `cell` pixels, less the mean of all; zero where none is known."""
    known = np.isfinite(z_um)
    total, _, count = cell_sums(z_um, z_um, known, cell)
    mean_um = np.float32(total.sum(dtype=np.float64) / max(count.sum(dtype=np.float64), 1.0))
    return np.where(count > 0.0, _means(total, count) - mean_um, np.float32(0.0))


def _means(total: Float32Array, count: Float32Array) -> Float32Array:
    """Means of cells, float32 array of shape (h, w), from their sums; zero where a cell holds nothing."""
    return np.asarray(total / np.maximum(count, np.float32(1.0)), np.float32)
