"""Bias from pixel noise of the mean slope of untouched skin: the map bends, so that its mean is not that of the mean.

A pixel's noise passes through a curved map: E[u(1 + n)] is not u(1). The difference is a few ten-thousandths of slope,
where a light is dark a hundredth, and it is the same in every frame: integrated, micrometres of bowl and tilt. It is
measured with the calibration's own pixels: of each the map reads 1 + n and 1 - n, whose mean holds no noise of the
first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import REFERENCE_BLUR_PX, NormalizedImage
from device.inverse_map.model import InverseMap, rest_likeness
from device.inverse_map.regressor import blocks_of, field_position
from device.surface import Float32Array, Float64Array

PIXELS: Final = 120_000
CELLS_ACROSS: Final = 24
"""Cells along the field's columns; what noise adds changes as slowly as the light does."""

MAX_FRAMES: Final = 5
"""So many frames show what noise is; beside an object's edge their median does not take it for noise."""

EDGE_POWER: Final = 7.0
"""Times the median power of its cell from which a pixel shows an edge: of normal noise in three colours 0.1 % do."""

MIN_TAKEN: Final = 0.2
"""Minimum factor on what is read of untouched skin for noisy pixels; below it noise is too loud to correct."""

_BATCH: Final = 8192


def correct_noise_bias(inverse_map: InverseMap, frames: Sequence[NormalizedImage]) -> InverseMap:
    """Return the map less what pixel noise adds on untouched skin, in `noise_bias`.

    Of a map that is free to miss untouched skin in `rest_bump`: noise carries pixels away from intensity 1, so that
    less is taken off them, and what is must be larger.

    frames : intensities whose noise is that of scans, most of whose pixels show smooth skin
    """
    if inverse_map.rest_bump is None:
        return replace(inverse_map, noise_bias=measure_noise_bias(inverse_map, frames))
    free = replace(inverse_map, rest_bump=None)
    noise, place, cell, cells = _noise_at_places(free, frames)
    read = np.concatenate([_even_part(free, noise[at], place[at]) for at in blocks_of(PIXELS, _BATCH)])
    alike = 0.5 * (rest_likeness(np.float32(1.0) + noise) + rest_likeness(np.float32(1.0) - noise))
    taken = _at_nodes(np.stack([alike, alike], axis=-1).astype(np.float64), cell, cells)
    bump = _at_nodes(read, cell, cells) / np.maximum(taken, np.float32(MIN_TAKEN))
    return replace(inverse_map, rest_bump=np.asarray(bump, np.float32))


def measure_noise_bias(inverse_map: InverseMap, frames: Sequence[NormalizedImage]) -> Float32Array:
    """Return the mean stereographic slope that pixel noise adds on untouched skin, nodes as in `InverseMap.noise_bias`.

    frames : as for `correct_noise_bias`
    """
    noise, place, cell, cells = _noise_at_places(inverse_map, frames)
    added = np.concatenate([_even_part(inverse_map, noise[at], place[at]) for at in blocks_of(PIXELS, _BATCH)])
    return _at_nodes(added, cell, cells)


def _noise_at_places(
    inverse_map: InverseMap, frames: Sequence[NormalizedImage]
) -> tuple[Float32Array, Float64Array, NDArray[np.intp], tuple[int, int]]:
    """Return pixel noise (N, 3) at random position variables (N, 2), and the cell of each.

    The last value is the number of cells down and across.
    """
    rows, columns = inverse_map.shape
    across = min(CELLS_ACROSS, columns)
    cells = max(round(across * rows / columns), 1), across
    rng = np.random.default_rng(0)
    row, column = (rng.integers(0, size, PIXELS) for size in inverse_map.shape)
    cell = (row * cells[0] // rows) * cells[1] + column * cells[1] // columns
    noise = _typical_noise([_fine(frame, row, column) for frame in _spread_over(frames)], cell, cells[0] * cells[1])
    place = field_position(column.astype(np.float64), row.astype(np.float64), inverse_map.shape)
    return noise, place, cell, cells


def _spread_over(frames: Sequence[NormalizedImage]) -> list[NormalizedImage]:
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), MAX_FRAMES)).round().astype(int))
    return [frames[number] for number in chosen]


def _fine(image: NormalizedImage, row: NDArray[np.intp], column: NDArray[np.intp]) -> Float32Array:
    """Return the difference of pixels from their surroundings: float32 (N, 3), 0 where clipped or invalid."""
    values = np.ascontiguousarray(image.values)
    own = values[row, column] - cv2.GaussianBlur(values, (0, 0), REFERENCE_BLUR_PX)[row, column]
    return np.where(image.faithful_at((row, column))[:, None], own, np.float32(0.0))


def _typical_noise(noises: Sequence[Float32Array], cell: NDArray[np.intp], count: int) -> Float32Array:
    """Return for every pixel the noise of that frame which is the median one in its cell, by power."""
    stack = np.stack(noises)
    power = np.stack([np.bincount(cell, (noise**2).sum(axis=1), count) for noise in noises])
    middle = np.argsort(power, axis=0)[(len(noises) - 1) // 2]
    return _without_edges(stack[middle[cell], np.arange(len(cell))], cell, count)


def _without_edges(noise: Float32Array, cell: NDArray[np.intp], count: int) -> Float32Array:
    """Return the noise with 0 where it is far louder than is usual in its cell: an edge, not noise."""
    power = (noise**2).sum(axis=1)
    order = np.lexsort((power, cell))
    pixels = np.bincount(cell, minlength=count)
    middle = np.cumsum(pixels) - pixels + pixels // 2
    usual = np.where(pixels > 0, power[order[np.minimum(middle, len(order) - 1)]], 0.0)
    return np.asarray(np.where((power <= EDGE_POWER * usual[cell])[:, None], noise, np.float32(0.0)), np.float32)


def _even_part(inverse_map: InverseMap, noise: Float32Array, place: Float64Array) -> Float64Array:
    more, less = (inverse_map.stereographic_at(np.float32(1.0) + sign * noise, place) for sign in (1, -1))
    return 0.5 * (more + less)


def _at_nodes(values: Float64Array, cell: NDArray[np.intp], cells: tuple[int, int]) -> Float32Array:
    """Return means over cells, (cells[0] + 1, cells[1] + 1, 2), carried to the cells' corners."""
    count = np.maximum(np.bincount(cell, minlength=cells[0] * cells[1]), 1)
    means = np.stack([np.bincount(cell, part, cells[0] * cells[1]) / count for part in values.T], axis=-1)
    padded: NDArray[Any] = np.pad(
        means.reshape(*cells, 2), ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd"
    )
    return np.asarray(0.25 * (padded[1:, 1:] + padded[:-1, 1:] + padded[1:, :-1] + padded[:-1, :-1]), np.float32)
