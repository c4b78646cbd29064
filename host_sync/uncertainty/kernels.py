"""Components of the uncertainty of every pixel, each in one pass over memory."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from device.surface import Float32Array, MaskArray
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows


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
