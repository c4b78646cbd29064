"""Validates a gradient field before integration and finds out whether it needs the weighted kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, GradientField, MaskArray
from host_sync.errors import IntegrationError
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

MIN_SIDE_PX: Final = 3

MIN_WEIGHT: Final = 1e-12
"""Weights below this fraction of the largest count as zero: their noise is a million times that of the best pixel, and
single precision cannot solve for both."""

INFINITE: Final = np.int32(0x7F800000)
MINUS_ZERO: Final = np.int32(-0x80000000)
"""Bit patterns of float32 infinity and minus zero; those of other non-finite numbers are larger or negative."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldInfo:
    """What a gradient field holds.

    weight : float32 array of shape (H, W), 0 at holes; None for a full rectangle of equal weights
    largest : largest weight; 1 for a full rectangle of equal weights
    """

    weight: Float32Array | None
    largest: float


def validate_field(gradients: GradientField) -> FieldInfo:
    """Check shapes and weights of a field; slopes are checked by `raise_slope_error` when heights are not finite.

    Raises
    ------
    IntegrationError
        Shapes differ or are too small, a valid pixel has no finite weight, or no pixel is valid.
    """
    shape = gradients.valid.shape
    if any(part.shape != shape for part in (gradients.p, gradients.q, gradients.weight)):
        shapes = ", ".join(f"{n} {getattr(gradients, n).shape}" for n in ("p", "q", "valid", "weight"))
        raise IntegrationError(f"arrays of the gradient field differ in shape ({shapes}): give arrays of one (H, W)")
    if len(shape) != 2 or min(shape) < MIN_SIDE_PX:
        raise IntegrationError(f"a gradient field of shape {shape} is too small: integration needs at least 3x3 pixels")
    if _is_broadcast_scalar(gradients.weight) and gradients.weight[0, 0] == 1.0 and _all_true(gradients.valid):
        return FieldInfo(None, 1.0)
    weight = np.ascontiguousarray(gradients.weight, np.float32)
    if _all_equal(gradients.valid, weight):
        return FieldInfo(None, 1.0)
    counts, extremes = np.zeros((shape[0], 3), np.int32), np.zeros((shape[0], 2), np.int32)
    parallel_rows(_scan_rows, shape, gradients.valid, weight.view(np.int32), counts, extremes)
    used, odd, stray = (int(count) for count in counts.sum(axis=0))
    if odd:
        raise IntegrationError(f"{odd} valid pixels have a negative or non-finite weight: mark them as invalid")
    if used == 0:
        raise IntegrationError(
            "no pixel of the gradient field is valid, so there is nothing to integrate: repeat the scan"
        )
    smallest, largest = (float(w.view(np.float32)) for w in (extremes[:, 0].min(), extremes[:, 1].max()))
    if used == weight.size and smallest == largest:
        return FieldInfo(None, 1.0)
    if stray:
        weight = np.where(gradients.valid, weight, np.float32(0.0))
    if smallest < MIN_WEIGHT * largest or largest < np.finfo(np.float32).tiny:
        return FieldInfo(_normalize(weight, largest), 1.0)
    return FieldInfo(weight, largest)


def _normalize(weight: Float32Array, largest: float) -> Float32Array:
    """The weights divided by the largest, 0 where the quotient is below `MIN_WEIGHT`."""
    fractions = weight.astype(np.float64) / largest
    return np.where(fractions >= MIN_WEIGHT, fractions, 0.0).astype(np.float32)


def _is_broadcast_scalar(values: NDArray[Any]) -> bool:
    """Whether all pixels share one number in memory (see `full_rectangle`)."""
    return not any(values.strides)


def _all_true(mask: MaskArray) -> bool:
    return bool(mask[0, 0] if _is_broadcast_scalar(mask) else mask.all())


def _all_equal(valid: MaskArray, weight: Float32Array) -> bool:
    """Whether every pixel is valid with the same weight: the common case, found in one fast pass."""
    if not (np.isfinite(weight[0, 0]) and weight[0, 0] > 0.0):
        return False
    others = np.zeros(len(weight), np.int32)
    parallel_rows(_count_others, weight.shape, valid, weight, weight[0, 0], others)
    return not others.any()


@njit(cache=True, nogil=True)
def _count_others(valid: Any, weight: Any, usual: Any, others: Any, first: int, last: int) -> None:
    """Write per row the number of pixels that are invalid or have another weight; stop at the first such row."""
    for r in range(first, last):
        others[r] = _row_others(valid[r], weight[r], usual)
        if others[r] > 0:
            return


@njit(cache=True)
def _row_others(valid: Any, weight: Any, usual: Any) -> Any:
    count = np.int32(0)
    for c in range(valid.size):
        count += np.int32(valid[c]) & np.int32(weight[c] == usual)
    return np.int32(valid.size) - count


def raise_slope_error(gradients: GradientField) -> None:
    """Raise the error that explains why heights are not finite.

    Raises
    ------
    IntegrationError
        A valid pixel has no finite slope, or slopes are too large.
    """
    finite = np.isfinite(gradients.p) & np.isfinite(gradients.q)
    faulty = gradients.valid & (gradients.weight > 0.0) & ~finite
    if faulty.any():
        raise IntegrationError(
            f"{faulty.sum()} valid pixels have a non-finite slope, the first in row {np.nonzero(faulty)[0][0]}: "
            "mark them as invalid"
        )
    used = gradients.valid & (gradients.weight > 0.0)
    steepest = np.where(used, np.maximum(np.abs(gradients.p), np.abs(gradients.q)), 0.0)
    row = int(np.argmax(steepest)) // used.shape[1]
    raise IntegrationError(
        f"slopes as large as {steepest.max():.2g} (row {row}) cannot be integrated in single precision: "
        "check their unit, or mark these pixels as invalid"
    )


@njit(cache=True, nogil=True)
def _scan_rows(valid: Any, bits: Any, counts: Any, extremes: Any, first: int, last: int) -> None:
    """Write per row: pixels used, valid ones without a usable weight, invalid ones with a weight; least and largest
    weight.

    bits : int32 array of shape (H, W), bit patterns of the weights; positive floats sort like their bits
    """
    for r in range(first, last):
        _scan_row(valid[r], bits[r], counts[r], extremes[r])


@njit(cache=True)
def _scan_row(valid: Any, bits: Any, counts: Any, extremes: Any) -> None:
    """Write the counts of one row, in integer arithmetic that compiles to vector code."""
    used, odd, stray = np.int32(0), np.int32(0), np.int32(0)
    least, largest = INFINITE, np.int32(0)
    for c in range(valid.size):
        w, counted = bits[c], np.int32(valid[c])
        positive = np.int32(w > 0)
        usable = counted & positive
        used += usable
        odd += counted & (np.int32(w >= INFINITE) | (np.int32(w < 0) & np.int32(w != MINUS_ZERO)))
        stray += (1 - counted) & np.int32(w != 0)
        least = min(least, w | ((usable - 1) & INFINITE))
        largest = max(largest, w & -usable)
    counts[0], counts[1], counts[2] = used, odd, stray
    extremes[0], extremes[1] = least, largest
