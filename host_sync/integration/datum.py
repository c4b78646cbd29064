"""Skin that nothing touches, where a height map has its zero.

It is flat over a patch, not only at a pixel, and reaches the frame's border; the plateau of an object is flat too, and
the skin that sinks towards rest around it is nearly so. As only patches count, the search works on cells of several
pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, GradientField, HeightMap, MaskArray
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

FLAT_SLOPES: Final = (0.01, 0.05)
"""Slopes under which a patch of skin counts as flat; the second is tried when the first finds too little."""

PATCH_FRACTION: Final = 1.0 / 64.0
"""Size of a patch as a share of the frame's columns."""

PATCH_CELLS: Final = 5
"""Cells along a patch; where a patch has fewer pixels, they are the cells."""

MIN_FRACTION: Final = 0.02
"""Share of the valid pixels that untouched skin must make up."""

MAX_SAMPLES: Final = 200_000
"""So many heights give a median to less than a thousandth of their spread."""


def untouched_mask(gradients: GradientField) -> MaskArray:
    """True where the skin is untouched: bool array of shape (H, W); every valid pixel when no such place is found."""
    found = skin_at_rest(gradients)
    return gradients.valid if found is None else found


def skin_at_rest(gradients: GradientField) -> MaskArray | None:
    """True where the skin is untouched: bool array of shape (H, W); None when no such place is found."""
    rows, columns = gradients.valid.shape
    cell = max(1, round(PATCH_FRACTION * columns) // PATCH_CELLS)
    patch = max(3, round(PATCH_FRACTION * columns / cell) | 1)
    p_sum, q_sum, count = cell_sums(gradients.p, gradients.q, gradients.valid, cell)
    known = np.maximum(cv2.blur(count, (patch, patch)), np.float32(1e-3))
    steepness = np.hypot(*(cv2.blur(total, (patch, patch)) / known for total in (p_sum, q_sum)))
    for limit in FLAT_SLOPES:
        flat = _reaching_the_border((count > 0) & (steepness < limit))
        if count[flat].sum(dtype=np.float64) >= MIN_FRACTION * count.sum(dtype=np.float64):
            pixels = np.repeat(np.repeat(flat, cell, axis=1), cell, axis=0)
            return gradients.valid & pixels[:rows, :columns]
    return None


def height_of_rest_um(height: HeightMap, at_rest: MaskArray) -> float:
    """Return the median height of the untouched skin, µm; 0 when none has a height."""
    step = max(1, int(np.sqrt(at_rest.size / MAX_SAMPLES)))
    sample = height.z_um[::step, ::step]
    heights = sample[at_rest[::step, ::step] & np.isfinite(sample)]
    return float(np.median(heights)) if heights.size else 0.0


def zero_to_datum(height: HeightMap, at_rest: MaskArray) -> HeightMap:
    """Return the height map with zero at the median of the untouched skin."""
    return HeightMap(height.z_um - np.float32(height_of_rest_um(height, at_rest)), height.pitch_um)


def cell_sums(
    p: Float32Array, q: Float32Array, valid: MaskArray, cell: int
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return sums of p and q, and number of valid pixels, in cells of `cell` x `cell` pixels: float32 arrays."""
    rows, columns = valid.shape
    sums = np.zeros((3, (rows + cell - 1) // cell, (columns + cell - 1) // cell), np.float32)
    parallel_rows(_add_cells, (sums.shape[1], columns), p, q, valid, cell, *sums)
    return sums[0], sums[1], sums[2]


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCells:
    """Sums over cells of a surface's pixels that have both a slope and a height: float32 arrays of shape (h, w).

    z_px : of heights over a zero, pixels
    p, q : of slopes
    count : how many such pixels there are
    skin : how many of them are skin that was asked for
    """

    z_px: Float32Array
    p: Float32Array
    q: Float32Array
    count: Float32Array
    skin: Float32Array

    @classmethod
    def of(
        cls, height: HeightMap, gradients: GradientField, zero_um: float, skin: MaskArray, cell: int
    ) -> SurfaceCells:
        """Return sums over cells of `cell` x `cell` pixels of a height map (H, W) and its slopes.

        At the field's border cells may hold fewer pixels.

        zero_um : height from which heights count
        skin : bool array of shape (H, W), skin that is asked for
        """
        rows, columns = skin.shape
        sums = np.zeros((5, -(-rows // cell), -(-columns // cell)), np.float32)
        surface = height.z_um, gradients.p, gradients.q, gradients.valid, skin
        scale = np.float32(zero_um), np.float32(height.pitch_um)
        parallel_rows(_add_surface, (sums.shape[1], cell * columns), *surface, *scale, cell, sums)
        return cls(*sums)


@njit(cache=True, nogil=True)
def _add_surface(
    z: Any, p: Any, q: Any, valid: Any, skin: Any, zero: Any, pitch: Any, cell: int, sums: Any, first: int, last: int
) -> None:
    """Add up the rows `first` to `last` - 1 of cells."""
    rows, columns = valid.shape
    held, own = np.empty((5, cell, columns), np.float32), np.empty(cell * cell, np.float32)
    for i in range(first, last):
        top, bottom = i * cell, min((i + 1) * cell, rows)
        for r in range(top, bottom):
            to = held[:, r - top]
            _hold_row(z[r], p[r], q[r], valid[r], skin[r], zero, pitch, to[0], to[1], to[2], to[3], to[4])
        for part in range(5):
            _sum_cells(held[part], bottom - top, cell, own, sums[part, i])


@njit(cache=True, error_model="numpy")
def _hold_row(
    z: Any, p: Any, q: Any, valid: Any, skin: Any, zero: Any, pitch: Any,
    to_z: Any, to_p: Any, to_q: Any, to_count: Any, to_skin: Any,
) -> None:  # fmt: skip
    """Write what each of a row's pixels adds to sums: nothing where it has no slope or no height."""
    nothing = np.float32(0.0)
    for c in range(z.size):
        known = valid[c] & np.isfinite(z[c])
        to_z[c] = (z[c] - zero) / pitch if known else nothing
        to_p[c] = p[c] if known else nothing
        to_q[c] = q[c] if known else nothing
        to_count[c] = np.float32(known)
        to_skin[c] = np.float32(known & skin[c])


@njit(cache=True)
def _sum_cells(held: Any, rows: int, cell: int, own: Any, sums: Any) -> None:
    """Write sums of a row of cells; four pixels are added up before they join a sum, which then rounds less often.

    held : what pixels add, shape (cell, columns), of which the first `rows` count
    own : room for the pixels of a cell
    """
    columns = held.shape[1]
    for j in range(sums.size):
        size = 0
        for r in range(rows):
            for c in range(j * cell, min((j + 1) * cell, columns)):
                own[size] = held[r, c]
                size += 1
        total, whole = np.float32(0.0), size - size % 4
        for k in range(0, whole, 4):
            total += own[k] + own[k + 1] + own[k + 2] + own[k + 3]
        for k in range(whole, size):
            total += own[k]
        sums[j] = total


@njit(cache=True, nogil=True)
def _add_cells(
    p: Any, q: Any, valid: Any, cell: int, p_sum: Any, q_sum: Any, count: Any, first: int, last: int
) -> None:
    """Add up the rows `first` to `last` - 1 of cells."""
    rows, columns = valid.shape
    for i in range(first, last):
        column = np.zeros((3, columns), np.float32)
        for r in range(i * cell, min((i + 1) * cell, rows)):
            _add_row(p[r], q[r], valid[r], column[0], column[1], column[2])
        for j in range(count.shape[1]):
            for c in range(j * cell, min((j + 1) * cell, columns)):
                p_sum[i, j] += column[0, c]
                q_sum[i, j] += column[1, c]
                count[i, j] += column[2, c]


@njit(cache=True)
def _add_row(p: Any, q: Any, valid: Any, p_sum: Any, q_sum: Any, count: Any) -> None:
    """Add a row's valid slopes and their number, column by column."""
    for c in range(p.size):
        p_sum[c] += p[c] if valid[c] else np.float32(0.0)
        q_sum[c] += q[c] if valid[c] else np.float32(0.0)
        count[c] += np.float32(valid[c])


def _reaching_the_border(mask: MaskArray) -> MaskArray:
    """Return the connected parts of a mask that touch the frame's border."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    reaching = np.zeros(labels.max() + 1, np.bool_)
    reaching[border] = True
    reaching[0] = False
    return np.asarray(reaching[labels])


def cell_means(
    p: Float32Array, q: Float32Array, valid: MaskArray, cell: int
) -> tuple[Float32Array, Float32Array, MaskArray]:
    """Return the mean slopes of cells of `cell` x `cell` pixels, 0 for those without a slope, and which have one."""
    p_sum, q_sum, count = cell_sums(p, q, valid, cell)
    known = count > 0.0
    number: Float32Array = np.maximum(count, np.float32(1.0)).astype(np.float32)
    return np.asarray(p_sum / number, np.float32), np.asarray(q_sum / number, np.float32), known


# Skin that is flat on the mean is the texture of an object that fills a field, or skin that nothing touches.
#
# Errors of slopes belong to no surface: integration keeps half of their power and removes the other half. Slopes of a
# surface it keeps. So where waves of some ten cells are kept with clearly more amplitude than is removed of them, an
# object shows.

ACROSS: Final = 240
"""Cells along the reduced field's columns."""

FINEST_CELLS: Final = 1.0
LONGEST_CELLS: Final = 6.0
"""Standard deviations of the Gaussians between which waves are compared, and within which their power is averaged."""

STEEP: Final = 0.1
AWAY_CELLS: Final = 18
"""Slope of an object's flanks, and cells from them within which the Gaussians bring their relief along."""

HOLE_CELLS: Final = 3
"""Cells from a hole within which slopes are those of its border."""

MAX_KEPT: Final = 1.5
"""Amplitude that integration keeps of slopes over what it removes, above which they are a surface.

The lowest tenth of untouched skin shows 0.6 to 0.8 on rendered and real sensors, of texture that fills the field 2.6 to
5.6.
"""

MIN_KEPT: Final = 0.004
"""Root mean square slope below which waves of an object's foot, which fade into untouched skin, are no texture."""

QUIETEST: Final = 0.1
MIN_CELLS: Final = 100
MIN_SIDE: Final = 4
"""Least number of cells, in all and along the field's shorter side."""


def is_relief(height: HeightMap, gradients: GradientField, skin: MaskArray) -> bool:
    """Return True where flat skin is an object's texture; False where too little of it lies far from steep flanks.

    gradients : slopes before they were integrated, arrays of shape (H, W)
    skin : bool array of shape (H, W)
    """
    cell = max(1, round(skin.shape[1] / ACROSS))
    cells = SurfaceCells.of(height, gradients, height_of_rest_um(height, skin), skin, cell)
    count = cells.count
    if min(count.shape) < MIN_SIDE:
        return False
    whole = np.maximum(cv2.GaussianBlur(count, (0, 0), FINEST_CELLS), np.float32(1e-6))
    z, p, q = (cv2.GaussianBlur(part, (0, 0), FINEST_CELLS) / whole for part in (cells.z_px, cells.p, cells.q))
    beside = _around(np.hypot(p, q) > STEEP, AWAY_CELLS) | _around(count < 1.0, HOLE_CELLS)
    inner = (cells.skin >= 0.5 * cell * cell) & ~beside
    if int(inner.sum()) < MIN_CELLS:
        return False
    by_p, by_q = (np.gradient(z, cell, axis=axis) for axis in (1, 0))
    kept, removed = _power(np.stack([by_p, by_q])), _power(np.stack([p - by_p, q - by_q]))
    ratio = np.sqrt(kept[inner] / np.maximum(removed[inner], np.float32(1e-12)))
    return bool(np.quantile(ratio, QUIETEST) > MAX_KEPT and np.quantile(kept[inner], QUIETEST) > MIN_KEPT**2)


def _around(mask: MaskArray, cells: int) -> MaskArray:
    """Return cells that are no farther from a mask."""
    square = np.ones((2 * cells + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), square).astype(np.bool_))


def _power(slopes: NDArray[np.floating]) -> Float32Array:
    """Return the mean square nearby of slopes (2, h, w) without their long waves."""
    fine = [part - cv2.GaussianBlur(part, (0, 0), LONGEST_CELLS) for part in slopes.astype(np.float32)]
    square = np.asarray(fine[0] * fine[0] + fine[1] * fine[1], np.float32)
    return np.asarray(cv2.GaussianBlur(square, (0, 0), LONGEST_CELLS), np.float32)
