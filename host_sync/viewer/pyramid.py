"""Pyramid of levels for the page: slopes and heights averaged 2 × 2 per level.

Slopes are averaged, not colours, so that a small relief does not sparkle. Means are taken over valid pixels; where none
is valid, heights come from the level above, so that holes have no walls.

A level is (rows, columns, 4) of half floats - p, q, and the height as a large and a small part whose sum has 22 bits -
and (rows, columns) of bytes, the fraction of valid pixels. Sizes are padded to a multiple of the coarsest cell, so that
each level lies exactly on the one below.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array

MIN_LEVEL_PX: Final = 96
MAX_LEVELS: Final = 8
MAX_SLOPE: Final = 1e4
"""Slopes are clipped here; half floats end at 65504."""

Half: TypeAlias = NDArray[np.float16]
Bytes: TypeAlias = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One level: half floats of shape (h, w, 4) and bytes of shape (h, w)."""

    surface: Half
    valid: Bytes


@dataclass(frozen=True, slots=True, eq=False)
class Means:
    """Means over cells: float32 arrays (h, w); p, q, z are 0 where the weight is 0."""

    p: Float32Array
    q: Float32Array
    z_um: Float32Array
    weight: Float32Array


def level_count(shape: tuple[int, int]) -> int:
    """Return the number of levels of a height map, including level 0."""
    count = 1
    while count < MAX_LEVELS and max(shape) >> (count - 1) > MIN_LEVEL_PX:
        count += 1
    return count


def padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the size of level 0: (H, W) padded to multiples of the coarsest level's cell."""
    cell = 1 << (level_count(shape) - 1)
    return -(-shape[0] // cell) * cell, -(-shape[1] // cell) * cell


def coarse_levels(z_um: Float32Array, pitch_um: float) -> list[Level]:
    """Return levels 1 and up of a height map, fine to coarse."""
    means = [_first_means(z_um, pitch_um)]
    for _ in range(level_count(z_um.shape) - 2):
        means.append(_halved(means[-1]))
    filled: Float32Array | None = None
    levels = []
    for mean in reversed(means[: level_count(z_um.shape) - 1]):
        filled = _filled(mean.z_um, mean.weight > 0, filled)
        levels.append(_level(mean, filled))
    return levels[::-1]


def finest_rows(z_um: Float32Array, pitch_um: float, above: Level | None, first: int, last: int) -> Level:
    """Return rows `first` to `last` of level 0, both even.

    above : level 1, which gives heights inside holes
    """
    p, q, weight = _slopes(z_um, pitch_um, first, last)
    shape = (last - first, padded_shape(z_um.shape)[1])
    inside = z_um[first:last]
    z = _padded(inside, shape)
    coarser = None
    if above is not None:
        coarse = above.surface[first // 2 : last // 2]
        coarser = coarse[..., 2].astype(np.float32) + coarse[..., 3].astype(np.float32)
    filled = _filled(np.nan_to_num(z), np.isfinite(z), coarser)
    return _level(Means(_padded(p, shape, 0.0), _padded(q, shape, 0.0), z, _padded(weight, shape, 0.0)), filled)


def _bands(rows: int, step: int = 512) -> Iterator[tuple[int, int]]:
    return ((first, min(first + step, rows)) for first in range(0, rows, step))


def _first_means(z_um: Float32Array, pitch_um: float) -> Means:
    """Return the level 1, computed in bands to save memory."""
    rows, columns = padded_shape(z_um.shape)
    half = (max(rows // 2, 1), max(columns // 2, 1))
    found = Means(*(np.zeros(half, np.float32) for _ in range(4)))
    for first, last in _bands(rows):
        shape = (last - first, columns)
        p, q, weight = _slopes(z_um, pitch_um, first, last)
        inside = np.where(weight > 0, z_um[first:last], np.float32(0.0)).astype(np.float32)
        fine = Means(*(_padded(part, shape, 0.0) for part in (p, q, inside, weight)))
        coarse = _halved(fine)
        there = slice(first // 2, last // 2)
        for name in ("p", "q", "z_um", "weight"):
            getattr(found, name)[there] = getattr(coarse, name)
    return found


def _slopes(
    z_um: Float32Array, pitch_um: float, first: int, last: int
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """p, q and weight (1 where both are finite) of some rows of a height map; fewer rows at its end."""
    rows = z_um.shape[0]
    first, last = min(first, rows), min(last, rows)
    top, bottom = max(first - 1, 0), min(last + 1, rows)
    if bottom - top < 2:
        top = max(bottom - 2, 0)
    if first == last:
        empty = np.zeros((0, z_um.shape[1]), np.float32)
        return empty, empty, empty
    q, p = np.gradient(z_um[top:bottom] / np.float32(pitch_um))
    kept = slice(first - top, last - top)
    p, q = p[kept], q[kept]
    # A central difference ignores its own pixel.
    known = np.isfinite(p) & np.isfinite(q) & np.isfinite(z_um[first:last])
    bounded = (np.where(known, np.clip(slope, -MAX_SLOPE, MAX_SLOPE), np.float32(0.0)) for slope in (p, q))
    p, q = (np.asarray(slope, np.float32) for slope in bounded)
    return p, q, known.astype(np.float32)


def _halved(fine: Means) -> Means:
    """Return means over 2 × 2 cells, weighted."""
    size = (max(fine.weight.shape[1] // 2, 1), max(fine.weight.shape[0] // 2, 1))

    def mean(values: Float32Array) -> Float32Array:
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)

    weight = mean(fine.weight)
    share = np.maximum(weight, np.float32(1e-6))
    p, q, z = (np.asarray(mean(part * fine.weight) / share, np.float32) for part in (fine.p, fine.q, fine.z_um))
    return Means(p, q, z, weight)


def _filled(z_um: Float32Array, known: NDArray[np.bool_], coarser: Float32Array | None) -> Float32Array:
    """Return heights, from the coarser level where invalid."""
    if known.all():
        return z_um
    if coarser is None:
        rest = float(z_um[known].mean()) if known.any() else 0.0
        return np.where(known, z_um, np.float32(rest))
    size = (z_um.shape[1], z_um.shape[0])
    return np.where(known, z_um, cv2.resize(coarser, size, interpolation=cv2.INTER_LINEAR))


def _padded(values: Float32Array, shape: tuple[int, int], blank: float = np.nan) -> Float32Array:
    if values.shape == shape:
        return np.asarray(values, np.float32)
    padded = np.full(shape, blank, np.float32)
    padded[: values.shape[0], : values.shape[1]] = values
    return padded


def _level(means: Means, z_um: Float32Array) -> Level:
    surface = np.empty((*z_um.shape, 4), np.float16)
    surface[..., 0], surface[..., 1] = means.p, means.q
    large = np.clip(z_um, -65000.0, 65000.0).astype(np.float16)
    surface[..., 2] = large
    surface[..., 3] = np.clip(z_um - large.astype(np.float32), -32.0, 32.0)
    return Level(surface, np.round(means.weight * 255.0).astype(np.uint8))
