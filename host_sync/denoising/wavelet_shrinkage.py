"""Wavelet shrinkage of an intensity image by a kernel that passes over memory once.

The image's root has shot noise of the same variance everywhere. An à-trous transform of it (Starck, Murtagh & Fadili,
"Sparse Image and Signal Processing", chapter 3; filter [1 2 1]/4, holes of 1, 2 and 4 pixels) leaves three planes of
detail and a smooth rest. A long wave leaks into all of them, into each a quarter of what it leaves in the next coarser
one; that share is taken out, so that what is shrunk of a finer plane costs no long wave. At each pixel the energy of
the three colours' detail, in units of its noise, or a share of that of the next coarser plane if that is more (what is
strong there goes on in finer planes), is averaged along five pixels in four directions; the largest of the four decides
how much of the detail is kept. A line keeps its energy along itself and survives, a speckle does not.

In the kernel a tile of columns runs down its band of rows. Sixteen rows of the root image, of its three smoothed
versions and of the three energies are held, so that a tile's working set stays in the second-level cache and every
pixel is read and written once. What a pixel becomes depends on its neighbourhood alone, not on bands, tiles or threads.

Long waves are left alone. Where a surface bends gently all of its detail is weaker than the noise, at every level, and
a long wave is the sum of such detail and a smooth rest: of a wave of 80 px shrinkage takes 1 to 2 %, of gentle slopes
as much. Over long waves noise averages out, so that nothing is won by it. What was taken is given back without its fine
detail.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface import Float32Array
from host_sync.kernels.cell_rows import as_stored, colour_rows, empty_planes
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

LEVELS: Final = 3
REACH_PX: Final = 2
"""Pixels on either side of the one whose energy is averaged along a direction."""

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

PARENT_FRACTION: Final = 0.1
"""Share of the next coarser plane's energy that speaks for detail of a plane.

Of a sinusoid of 20 px and 17° a rendered sensor keeps 0.98, as without shrinkage, instead of 0.957; untouched skin
is as quiet as without.
"""

MIN_ENERGY: Final = np.float32(1e-12)


@dataclass(frozen=True, slots=True, eq=False)
class Shrinkage:
    """Parameters of the shrinkage of detail.

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
        smoother = _smoothed(smooth, 1 << level)
        details.append(smooth - smoother)
        smooth = smoother
    for fine, coarse in pairwise(details):
        fine -= np.float32(LEAK) * coarse
    return details, smooth


def _smoothed(image: Float32Array, hole: int) -> Float32Array:
    """Return the image averaged with its neighbours at `hole` pixels, ¼, ½, ¼ along both axes."""
    weights = np.zeros(2 * hole + 1, np.float32)
    weights[[0, hole, -1]] = 0.25, 0.5, 0.25
    smooth = cv2.sepFilter2D(image, -1, weights, weights, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(smooth, np.float32).reshape(image.shape)


TILE_PX: Final = 480
"""Columns that are worked on at a time."""

_RING: Final = 16
"""Rows held of every plane, a power of two above the 12 that are needed."""

_LAST: Final = _RING - 1
_PLANES: Final = LEVELS + 1
_LAG: Final = (1 << LEVELS) - 1
_ONE: Final = np.float32(1.0)
_ZERO: Final = np.float32(0.0)
_HALF: Final = np.float32(0.5)
_QUARTER: Final = np.float32(0.25)
_THIRD: Final = np.float32(1.0 / 3.0)
_FIFTH: Final = np.float32(0.2)
_LEAK: Final = np.float32(LEAK)
_PARENT: Final = np.float32(PARENT_FRACTION)
_SHARES: Final = tuple(np.float32(share) for share in SHARES)
_CONTRACT: Final = {"contract", "nsz"}


def shrink(image: NormalizedImage, shrinkage: Shrinkage) -> NormalizedImage:
    """Return the image with its noise shrunk; validity and clipping stay."""
    values = empty_planes(image.shape)
    parallel_rows(
        _shrink_rows, image.shape, *as_stored(image.values), np.moveaxis(values, -1, 0),
        np.ascontiguousarray(shrinkage.whitening, np.float32), np.ascontiguousarray(shrinkage.threshold, np.float32),
        np.ascontiguousarray(shrinkage.kept, np.float32),
    )  # fmt: skip
    return NormalizedImage(values, image.valid, image.clipped)


@njit(cache=True, nogil=True)
def _shrink_rows(
    stored: Any, by_plane: bool, out: Any, whitening: Any, threshold: Any, kept: Any, first: int, last: int
) -> None:
    """Write the rows `first` to `last` - 1 of `out`, float32 array of shape (3, H, W)."""
    rows, columns = out.shape[1:]
    width = min(TILE_PX, columns) + 2 * HALO_PX
    planes = np.empty((_PLANES, 3, _RING, width), np.float32)
    energy = np.empty((LEVELS, _RING, width), np.float32)
    spare, part, gain = np.empty((3, width), np.float32), np.empty(width, np.float32), np.empty((2, width), np.float32)
    for start in range(0, columns, TILE_PX):
        end = min(start + TILE_PX, columns)
        size = end - start + 2 * HALO_PX
        for r in range(first - HALO_PX, last + HALO_PX):
            seen = min(max(r, 0), rows - 1)
            _load(stored, by_plane, seen, start, end, columns, spare, planes[0, :, r & _LAST])
            _smooth_step(planes, 0, r, size, part)
            _smooth_step(planes, 1, r - 1, size, part)
            _smooth_step(planes, 2, r - 3, size, part)
            at = r - _LAG
            now = at & _LAST
            for level in range(LEVELS - 1, -1, -1):
                fine, rest, coarse = planes[level, :, now], planes[level + 1, :, now], planes[_beyond(level), :, now]
                _energy_row(fine, rest, coarse, whitening[level], size, energy[level, now])
                if level + 1 < LEVELS:
                    _hear_parent(energy[level + 1, now], size, energy[level, now])
            row = r - HALO_PX
            if row >= first:
                _write_row(planes, energy, threshold, kept, row, start, end, gain, out)


@njit(cache=True)
def _load(
    stored: Any, by_plane: bool, row: int, start: int, end: int, columns: int, spare: Any, root: Any
) -> None:  # fmt: skip
    """Write the root of a row's three colours; beyond the border the outermost pixel repeats."""
    left, right = max(start - HALO_PX, 0), min(end + HALO_PX, columns)
    colours = colour_rows(stored, by_plane, row, left, right, spare)
    before = left - (start - HALO_PX)
    inside = right - left
    size = end - start + 2 * HALO_PX
    for channel in range(3):
        values = colours[channel]
        own = root[channel]
        _root_row(values, own[before : before + inside])
        own[:before] = own[before]
        own[before + inside : size] = own[before + inside - 1]


@njit(cache=True, error_model="numpy")
def _root_row(values: Any, out: Any) -> None:
    for c in range(out.size):
        out[c] = np.sqrt(max(values[c], _ZERO))


@njit(cache=True)
def _smooth_step(planes: Any, level: int, newest: int, size: int, part: Any) -> None:
    """Smooth a level's row at its hole's distance above the newest into the next level."""
    hole = 1 << level
    row = newest - hole
    for channel in range(3):
        plane, out = planes[level, channel], planes[level + 1, channel, row & _LAST]
        _down(plane[(row - hole) & _LAST], plane[row & _LAST], plane[newest & _LAST], size, part)
        _across(part, hole, size, out)


@njit(cache=True, fastmath=_CONTRACT)
def _down(above: Any, here: Any, below: Any, size: int, out: Any) -> None:
    for c in range(size):
        out[c] = _HALF * here[c] + _QUARTER * (above[c] + below[c])


@njit(cache=True, fastmath=_CONTRACT)
def _across(row: Any, hole: int, size: int, out: Any) -> None:
    here, left, right, inner = row[hole : size - hole], row[: size - 2 * hole], row[2 * hole : size], out[hole:]
    for c in range(here.size):
        inner[c] = _HALF * here[c] + _QUARTER * (left[c] + right[c])
    out[:hole] = _ZERO
    out[size - hole : size] = _ZERO


@njit(cache=True, fastmath=_CONTRACT)
def _energy_row(fine: Any, rest: Any, coarse: Any, w: Any, size: int, out: Any) -> None:
    """Write the energy of the detail between two levels' rows, arrays of shape (3, n), without its leak."""
    fine0, fine1, fine2 = fine[0], fine[1], fine[2]
    rest0, rest1, rest2 = rest[0], rest[1], rest[2]
    coarse0, coarse1, coarse2 = coarse[0], coarse[1], coarse[2]
    w00, w01, w02, w11, w12, w22 = w[0, 0], w[0, 1], w[0, 2], w[1, 1], w[1, 2], w[2, 2]
    for c in range(size):
        red = fine0[c] - rest0[c] - _LEAK * (rest0[c] - coarse0[c])
        green = fine1[c] - rest1[c] - _LEAK * (rest1[c] - coarse1[c])
        blue = fine2[c] - rest2[c] - _LEAK * (rest2[c] - coarse2[c])
        first = w00 * red + w01 * green + w02 * blue
        second = w11 * green + w12 * blue
        third = w22 * blue
        out[c] = (first * first + second * second + third * third) * _THIRD


@njit(cache=True)
def _hear_parent(coarser: Any, size: int, energy: Any) -> None:
    for c in range(size):
        energy[c] = max(energy[c], _PARENT * coarser[c])


@njit(cache=True)
def _beyond(level: int) -> int:
    """Return the plane that a level's leak is taken from; for the coarsest its own rest, so that it keeps its leak."""
    return min(level + 2, LEVELS)


@njit(cache=True)
def _write_row(
    planes: Any, energy: Any, threshold: Any, kept: Any, row: int, start: int, end: int, gain: Any, out: Any
) -> None:  # fmt: skip
    """Write a row of a tile: the smooth rest and what is kept of each level's detail, squared."""
    at = row & _LAST
    count = end - start
    inner = slice(HALO_PX, HALO_PX + count)
    for level in range(LEVELS):
        ring = energy[level]
        _gain_row(
            ring[(row - 2) & _LAST], ring[(row - 1) & _LAST], ring[at],
            ring[(row + 1) & _LAST], ring[(row + 2) & _LAST],
            threshold[level], kept[level], _SHARES[level], gain[0, :count],
        )  # fmt: skip
        for channel in range(3):
            fine, rest = planes[level, channel, at, inner], planes[level + 1, channel, at, inner]
            coarse = planes[_beyond(level), channel, at, inner]
            _add_detail(fine, rest, coarse, gain[0], level == 0, out[channel, row, start:end])
    for channel in range(3):
        _square_sum(planes[LEVELS, channel, at, inner], out[channel, row, start:end])


@njit(cache=True, fastmath=_CONTRACT, error_model="numpy")
def _gain_row(
    above2: Any, above: Any, here: Any, below: Any, below2: Any, threshold: Any, kept: Any, whole: Any, out: Any
) -> None:  # fmt: skip
    """Write what share of a level's detail is kept, times what all of it counts."""
    first = HALO_PX - 2
    size = out.size + 4
    a2, a1, b1, b2 = above2[first:], above[first:], below[first:], below2[first:]
    h = here[first : first + size]
    for c in range(out.size):
        middle = h[c + 2]
        flat = h[c] + h[c + 1] + middle + h[c + 3] + h[c + 4]
        upright = a2[c + 2] + a1[c + 2] + middle + b1[c + 2] + b2[c + 2]
        falling = a2[c] + a1[c + 1] + middle + b1[c + 3] + b2[c + 4]
        rising = a2[c + 4] + a1[c + 3] + middle + b1[c + 1] + b2[c]
        largest = max(max(flat, upright), max(falling, rising)) * _FIFTH
        lost = threshold / max(largest, MIN_ENERGY)
        share = max(_ZERO, _ONE - lost * lost)
        out[c] = whole * (kept + (_ONE - kept) * share)


@njit(cache=True, fastmath=_CONTRACT)
def _add_detail(fine: Any, rest: Any, coarse: Any, gain: Any, begin: bool, out: Any) -> None:
    if begin:
        for c in range(out.size):
            out[c] = gain[c] * (fine[c] - rest[c] - _LEAK * (rest[c] - coarse[c]))
    else:
        for c in range(out.size):
            out[c] += gain[c] * (fine[c] - rest[c] - _LEAK * (rest[c] - coarse[c]))


@njit(cache=True, fastmath=_CONTRACT)
def _square_sum(rest: Any, out: Any) -> None:
    for c in range(out.size):
        total = out[c] + rest[c]
        out[c] = total * total


GAUSSIAN_PX: Final = 6.0
"""Standard deviation of the Gaussian whose share of the loss is given back: 0.9 of a wave of 80 px, 0.02 of 14 px."""

CELL_PX: Final = 4
"""It works on means of cells of so many pixels."""


def shrink_but_long_waves(image: NormalizedImage, shrinkage: Shrinkage) -> NormalizedImage:
    """Return the image (H, W, 3) with the noise of its detail shrunk; validity and clipping stay."""
    shrunk = shrink(image, shrinkage)
    rows, columns = image.shape
    cells = (max(columns // CELL_PX, 1), max(rows // CELL_PX, 1))
    stored, by_plane = as_stored(image.values)
    for channel, plane in enumerate(np.moveaxis(shrunk.values, -1, 0)):
        seen = stored[channel] if by_plane else np.ascontiguousarray(stored[..., channel])
        before, after = (cv2.resize(one, cells, interpolation=cv2.INTER_AREA) for one in (seen, plane))
        lost = cv2.GaussianBlur(before - after, (0, 0), GAUSSIAN_PX / CELL_PX)
        plane += cv2.resize(lost, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return shrunk
