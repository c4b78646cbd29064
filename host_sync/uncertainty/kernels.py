"""Components of the uncertainty of every pixel, each in one pass over memory.

One of them is detail that shrinkage took with the noise: of rough skin, whose detail is as loud as the noise. The raw
surface still holds that detail. Where its fine slopes are louder than the calibration's noise, and shrinkage took much
of them, so much of what is louder is missing in the surface with shrunk detail, and as much again of what lens and
integration kept from either. Where it took little of strong detail, what it took was noise of other planes.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from device.surface import Float32Array, MaskArray
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.results.record import SlopeNoise


class PiecewiseLinear(NamedTuple):
    """A function that runs straight between knots, as a sum of bends: level + Σ bend · max(x - knot, 0) up to `last`.

    So written it takes no search, and the compiler turns it into vector instructions.
    """

    level: np.float32
    knot: Float32Array
    bend: Float32Array
    last: np.float32


def piecewise_linear(knots: Any, values: Any) -> PiecewiseLinear:
    """Return the function that `numpy.interp` evaluates; knots ascend."""
    x, y = np.asarray(knots, np.float64), np.asarray(values, np.float64)
    slopes = np.diff(y) / np.diff(x)
    bends = np.diff(slopes, prepend=0.0)
    return PiecewiseLinear(np.float32(y[0]), x[:-1].astype(np.float32), bends.astype(np.float32), np.float32(x[-1]))


def sigma_by_tilt(
    slopes: tuple[Float32Array, Float32Array],
    parts: tuple[PiecewiseLinear, PiecewiseLinear],
    weight: Float32Array,
    valid: MaskArray,
    nonintegrable: Float32Array,
    calibration_sigma: Float32Array,
) -> Float32Array:
    """Return the standard uncertainty of a slope: float32 array of shape (H, W), NaN where invalid.

    slopes : p and q of the surface
    parts : pixel and patch part of the error by the cosine of the tilt, radians
    weight : relative confidence, kept above zero
    nonintegrable : least error that the surface itself betrays
    calibration_sigma : of the calibration, beside all else
    """
    out = np.empty(weight.shape, np.float32)
    parallel_rows(_write_sigma, out.shape, *slopes, *parts, weight, valid, nonintegrable, calibration_sigma, out)
    return out


def squared_tilt(p: Float32Array, q: Float32Array, valid: MaskArray, most: float) -> Float32Array:
    """p² + q², at most `most`, zero where invalid: float32 array of shape (H, W)."""
    out = np.empty(p.shape, np.float32)
    parallel_rows(_write_squares, out.shape, p, q, valid, np.float32(most), out)
    return out


def removed_slope(estimated: Float32Array, integrated: Float32Array, valid: MaskArray) -> Float32Array:
    """Return what integration took from a slope, zero where it took nothing: float32 array of shape (H, W)."""
    out = np.empty(estimated.shape, np.float32)
    parallel_rows(_write_removed, out.shape, estimated, integrated, valid, out)
    return out


def with_scale(sigma_um: Float32Array, share: float, z_um: Float32Array, valid: MaskArray) -> Float32Array:
    """√(σ² + (share · z)²), NaN where invalid: float32 array of shape (H, W)."""
    out = np.empty(z_um.shape, np.float32)
    parallel_rows(_write_with_scale, out.shape, sigma_um, np.float32(share), z_um, valid, out)
    return out


@njit(cache=True, nogil=True)
def _write_sigma(
    p: Any, q: Any, pixel: PiecewiseLinear, patch: PiecewiseLinear, weight: Any, valid: Any, nonintegrable: Any,
    calibration_sigma: Any, out: Any, first: int, last: int,
) -> None:  # fmt: skip
    columns = out.shape[1]
    square, cosine = np.empty(columns, np.float32), np.empty(columns, np.float32)
    parts = np.empty((2, columns), np.float32)
    for r in range(first, last):
        _tilt_row(p[r], q[r], square, cosine)
        _bent_row(pixel, cosine, parts[0])
        _bent_row(patch, cosine, parts[1])
        _sigma_row(square, parts[0], parts[1], weight[r], valid[r], nonintegrable[r], calibration_sigma[r], out[r])


@njit(cache=True, error_model="numpy")
def _tilt_row(p: Any, q: Any, square: Any, cosine: Any) -> None:
    for c in range(square.size):
        square[c] = p[c] * p[c] + q[c] * q[c]
        cosine[c] = np.float32(1.0) / np.sqrt(np.float32(1.0) + square[c])


@njit(cache=True)
def _bent_row(function: PiecewiseLinear, x: Any, out: Any) -> None:
    for c in range(out.size):
        out[c] = function.level
    for k in range(function.knot.size):
        knot, bend = function.knot[k], function.bend[k]
        for c in range(out.size):
            out[c] += bend * max(min(x[c], function.last) - knot, np.float32(0.0))


@njit(cache=True, error_model="numpy")
def _sigma_row(
    square: Any, pixel: Any, patch: Any, weight: Any, valid: Any, nonintegrable: Any, calibration_sigma: Any, out: Any
) -> None:
    one, nine, nan = np.float32(1.0), np.float32(9.0), np.float32(np.nan)
    for c in range(out.size):
        own = np.sqrt(pixel[c] * pixel[c] + patch[c] * patch[c])
        # So ordered that a slope which is no number makes the uncertainty none.
        own *= one + (nine if square[c] > nine else square[c])
        own /= np.sqrt(weight[c])
        larger = nonintegrable[c] if nonintegrable[c] > own else own
        total = np.sqrt(larger * larger + calibration_sigma[c] * calibration_sigma[c])
        out[c] = total if valid[c] else nan


@njit(cache=True, nogil=True)
def _write_squares(p: Any, q: Any, valid: Any, most: Any, out: Any, first: int, last: int) -> None:
    for r in range(first, last):
        _squares_row(p[r], q[r], valid[r], most, out[r])


@njit(cache=True)
def _squares_row(p: Any, q: Any, valid: Any, most: Any, out: Any) -> None:
    for c in range(out.size):
        square = min(p[c] * p[c] + q[c] * q[c], most)
        out[c] = square if valid[c] else np.float32(0.0)


@njit(cache=True, nogil=True)
def _write_removed(estimated: Any, integrated: Any, valid: Any, out: Any, first: int, last: int) -> None:
    for r in range(first, last):
        _removed_row(estimated[r], integrated[r], valid[r], out[r])


@njit(cache=True)
def _removed_row(estimated: Any, integrated: Any, valid: Any, out: Any) -> None:
    for c in range(out.size):
        removed = estimated[c] - integrated[c]
        out[c] = removed if valid[c] & np.isfinite(removed) else np.float32(0.0)


@njit(cache=True, nogil=True)
def _write_with_scale(sigma: Any, share: Any, z: Any, valid: Any, out: Any, first: int, last: int) -> None:
    for r in range(first, last):
        _with_scale_row(sigma[r], share, z[r], valid[r], out[r])


@njit(cache=True)
def _with_scale_row(sigma: Any, share: Any, z: Any, valid: Any, out: Any) -> None:
    for c in range(out.size):
        scale = share * z[c]
        total = np.sqrt(sigma[c] * sigma[c] + scale * scale)
        out[c] = total if valid[c] else np.float32(np.nan)


CELL_PX: Final = 4
PATCH_CELLS: Final = 1.5
"""Size of a cell, and standard deviation in cells of the patch over which energies are averaged."""

REACH: Final = 4
"""Pixels from a slope to the four whose mean is taken off it: what is left is fine."""

OF_NOISE: Final = np.float32(1.25)
"""Variance of what is so left of noise that does not reach so far, over the noise's own."""

LOUDER: Final = np.float32(1.5)
"""Energy of fine slopes, over that of the calibration's noise, beyond which it is detail: noise is louder in places.

On untouched skin of five rendered devices the middle of the field has 1.15 to 1.45 times it, a tenth 1.9 to 2.9.
"""

UNSEEN: Final = np.float32(2.0)
"""Ratio of missing detail to the detail that the raw surface shows."""

MOSTLY: Final = np.float32(0.25)
"""Share of detail's energy from which on what shrinkage takes counts as detail in full."""

SlopePair = tuple[Float32Array, Float32Array]


def lost_variance(raw: SlopePair, shrunk: SlopePair, noise: SlopeNoise) -> Float32Array:
    """Return the variance of either slope that the surface with shrunk detail lacks, on cells: float32 array (h, w).

    raw, shrunk : slopes p and q of both surfaces, float32 arrays of shape (H, W)
    noise : of the calibration
    """
    rows, columns = raw[0].shape
    shape = (-(-rows // CELL_PX), -(-columns // CELL_PX))
    planes = np.zeros((3, *shape), np.float32)
    parallel_rows(_write_energies, (shape[0], columns), *raw, *shrunk, planes)
    fine, apart, square = (cv2.GaussianBlur(plane, (0, 0), PATCH_CELLS) for plane in planes)
    fine /= OF_NOISE
    taken = np.minimum(apart / np.maximum(fine, np.float32(1e-12)), np.float32(1.0))
    louder = np.maximum(fine - LOUDER * noise.variance(square, "raw"), np.float32(0.0))
    return np.asarray(UNSEEN * taken * np.minimum(taken / MOSTLY, np.float32(1.0)) * louder, np.float32)


def with_lost_detail(sigma: Float32Array, lost: Float32Array) -> Float32Array:
    """Return the standard uncertainty of slopes, float32 array of shape (H, W), with a variance on cells beside it."""
    rows, columns = sigma.shape
    more = np.asarray(cv2.resize(lost, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)
    parallel_rows(_add_variance, sigma.shape, sigma, more)
    return more


@njit(cache=True, nogil=True)
def _write_energies(p: Any, q: Any, own_p: Any, own_q: Any, planes: Any, first: int, last: int) -> None:
    """Write mean squares of fine raw slopes, of what both differ by, and p² + q², for cells' rows from `first` on."""
    rows, columns = p.shape
    lines, detail = np.empty((3, columns), np.float32), np.empty(columns, np.float32)
    fine, apart, square = lines[0], lines[1], lines[2]
    for i in range(first, last):
        top, bottom = i * CELL_PX, min((i + 1) * CELL_PX, rows)
        lines[:] = np.float32(0.0)
        for r in range(top, bottom):
            above, below = max(r - REACH, 0), min(r + REACH, rows - 1)
            _add_row(p[above], p[r], p[below], own_p[r], detail, fine, apart, square)
            _add_row(q[above], q[r], q[below], own_q[r], detail, fine, apart, square)
        for j in range(planes.shape[2]):
            end = min((j + 1) * CELL_PX, columns)
            pixels = np.float32((bottom - top) * (end - j * CELL_PX))
            for c in range(j * CELL_PX, end):
                planes[0, i, j] += fine[c] * np.float32(0.5) / pixels
                planes[1, i, j] += apart[c] * np.float32(0.5) / pixels
                planes[2, i, j] += square[c] / pixels


@njit(cache=True)
def _add_row(above: Any, here: Any, below: Any, own: Any, detail: Any, fine: Any, apart: Any, square: Any) -> None:
    """Add a row's squares; beyond the border the outermost pixels repeat.

    detail : receives the row's fine slopes
    """
    columns = here.size
    end = max(columns - REACH, REACH)
    if end > REACH:
        inner = slice(REACH, end)
        _write_fine(above[inner], here[: end - REACH], here[inner], here[2 * REACH :], below[inner], detail[inner])
    for c in range(columns):
        if c < REACH or c >= end:
            around = above[c] + below[c] + here[max(c - REACH, 0)] + here[min(c + REACH, columns - 1)]
            detail[c] = here[c] - np.float32(0.25) * around
    _add_squares(detail, here, own, fine, apart, square)


@njit(cache=True)
def _write_fine(above: Any, left: Any, here: Any, right: Any, below: Any, detail: Any) -> None:
    for c in range(detail.size):
        detail[c] = here[c] - np.float32(0.25) * (above[c] + below[c] + left[c] + right[c])


@njit(cache=True)
def _add_squares(detail: Any, here: Any, own: Any, fine: Any, apart: Any, square: Any) -> None:
    """Add squares; what is no number, or has a neighbour that is none, counts as nothing."""
    nothing = np.float32(0.0)
    for c in range(detail.size):
        difference = here[c] - own[c]
        known = (detail[c] == detail[c]) & (difference == difference)
        fine[c] += detail[c] * detail[c] if known else nothing
        apart[c] += difference * difference if known else nothing
        square[c] += own[c] * own[c] if known else nothing


@njit(cache=True, nogil=True)
def _add_variance(sigma: Any, more: Any, first: int, last: int) -> None:
    for r in range(first, last):
        for c in range(sigma.shape[1]):
            more[r, c] = np.sqrt(sigma[r, c] * sigma[r, c] + more[r, c])
