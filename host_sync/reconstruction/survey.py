"""Looks at a gradient field's weights before it is integrated, and tells which kernels it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from device.surface import Float32Array, GradientField, MaskArray
from host_sync.errors import IntegrationError
from host_sync.reconstruction.row_bands import in_bands

LEAST_SIDE_PX: Final = 3

LEAST_WEIGHT: Final = 1e-12
"""Share of the largest weight under which a weight counts as nought: noise is then a million times that of the best
pixel, and single precision does not solve for both."""

INFINITE: Final = np.int32(0x7F800000)
MINUS_NOUGHT: Final = np.int32(-0x80000000)
"""Bits of the float32 values that they are named after; those of numbers that are not finite are larger or negative."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldSurvey:
    """What a gradient field holds.

    weight : float32 array of shape (H, W), nought at holes; None for a full rectangle of equal weights
    largest : largest weight; 1 for a full rectangle of equal weights
    """

    weight: Float32Array | None
    largest: float


def survey(gradients: GradientField) -> FieldSurvey:
    """What the field holds; slopes are not looked at (see `refuse_slopes`).

    Raises
    ------
    IntegrationError
        Shapes differ or are too small, a valid pixel has no finite weight, or no pixel is valid.
    """
    shape = gradients.valid.shape
    if any(part.shape != shape for part in (gradients.p, gradients.q, gradients.weight)):
        shapes = ", ".join(f"{n} {getattr(gradients, n).shape}" for n in ("p", "q", "valid", "weight"))
        raise IntegrationError(f"the parts of the gradient field differ in shape ({shapes}): give arrays of one (H, W)")
    if len(shape) != 2 or min(shape) < LEAST_SIDE_PX:
        raise IntegrationError(f"a gradient field of shape {shape} is too small: integration needs 3x3 pixels or more")
    if _is_one_number(gradients.weight) and gradients.weight[0, 0] == 1.0 and _holds_everywhere(gradients.valid):
        return FieldSurvey(None, 1.0)
    weight = np.ascontiguousarray(gradients.weight, np.float32)
    if _all_alike(gradients.valid, weight):
        return FieldSurvey(None, 1.0)
    counts, extremes = np.zeros((shape[0], 3), np.int32), np.zeros((shape[0], 2), np.int32)
    in_bands(_survey_rows, shape, gradients.valid, weight.view(np.int32), counts, extremes)
    used, odd, stray = (int(count) for count in counts.sum(axis=0))
    if odd:
        raise IntegrationError(f"{odd} valid pixels have a negative or no finite weight: mark them as not valid")
    if used == 0:
        raise IntegrationError(
            "no pixel of the gradient field is valid: nothing can be integrated, take the scan again"
        )
    smallest, largest = (float(w.view(np.float32)) for w in (extremes[:, 0].min(), extremes[:, 1].max()))
    if used == weight.size and smallest == largest:
        return FieldSurvey(None, 1.0)
    if stray:
        weight = np.where(gradients.valid, weight, np.float32(0.0))
    if smallest < LEAST_WEIGHT * largest or largest < np.finfo(np.float32).tiny:
        return FieldSurvey(_within_range(weight, largest), 1.0)
    return FieldSurvey(weight, largest)


def _within_range(weight: Float32Array, largest: float) -> Float32Array:
    """The weights as shares of the largest, nought where that is too small to count."""
    shares = weight.astype(np.float64) / largest
    return np.where(shares >= LEAST_WEIGHT, shares, 0.0).astype(np.float32)


def _is_one_number(values: NDArray[Any]) -> bool:
    """Whether all pixels are the same one in memory (see `full_rectangle`)."""
    return not any(values.strides)


def _holds_everywhere(mask: MaskArray) -> bool:
    return bool(mask[0, 0] if _is_one_number(mask) else mask.all())


def _all_alike(valid: MaskArray, weight: Float32Array) -> bool:
    """Whether every pixel is valid and weighs the same: the common case, and quickly seen."""
    if not (np.isfinite(weight[0, 0]) and weight[0, 0] > 0.0):
        return False
    strangers = np.zeros(len(weight), np.int32)
    in_bands(_count_strangers, weight.shape, valid, weight, weight[0, 0], strangers)
    return not strangers.any()


@njit(cache=True, nogil=True)
def _count_strangers(valid: Any, weight: Any, usual: Any, strangers: Any, first: int, last: int) -> None:
    """Write per row how many pixels are not valid or have another weight, unless a row before had some."""
    for r in range(first, last):
        strangers[r] = _row_strangers(valid[r], weight[r], usual)
        if strangers[r] > 0:
            return


@njit(cache=True)
def _row_strangers(valid: Any, weight: Any, usual: Any) -> Any:
    count = np.int32(0)
    for c in range(valid.size):
        count += np.int32(valid[c]) & np.int32(weight[c] == usual)
    return np.int32(valid.size) - count


def refuse_slopes(gradients: GradientField) -> None:
    """Raise the error that says why heights came out that are not finite.

    Raises
    ------
    IntegrationError
        A valid pixel has no finite slope, or slopes are too large.
    """
    finite = np.isfinite(gradients.p) & np.isfinite(gradients.q)
    faulty = gradients.valid & (gradients.weight > 0.0) & ~finite
    if faulty.any():
        raise IntegrationError(
            f"{faulty.sum()} valid pixels have no finite slope, the first in row {np.nonzero(faulty)[0][0]}: "
            "mark them as not valid"
        )
    used = gradients.valid & (gradients.weight > 0.0)
    steepest = np.where(used, np.maximum(np.abs(gradients.p), np.abs(gradients.q)), 0.0)
    row = int(np.argmax(steepest)) // used.shape[1]
    raise IntegrationError(
        f"slopes as large as {steepest.max():.2g} (row {row}) cannot be integrated in single precision: "
        "check their unit, or mark such pixels as not valid"
    )


@njit(cache=True, nogil=True)
def _survey_rows(valid: Any, bits: Any, counts: Any, extremes: Any, first: int, last: int) -> None:
    """Write per row: pixels used, valid ones without a proper weight, others with one; least and largest weight used.

    bits : int32 array of shape (H, W), the weights' bits: positive floats are ordered as these are
    """
    for r in range(first, last):
        _survey_row(valid[r], bits[r], counts[r], extremes[r])


@njit(cache=True)
def _survey_row(valid: Any, bits: Any, counts: Any, extremes: Any) -> None:
    """Write the figures of one row; whole numbers, which are counted many at a time."""
    used, odd, stray = np.int32(0), np.int32(0), np.int32(0)
    least, largest = INFINITE, np.int32(0)
    for c in range(valid.size):
        w, counted = bits[c], np.int32(valid[c])
        positive = np.int32(w > 0)
        usable = counted & positive
        used += usable
        odd += counted & (np.int32(w >= INFINITE) | (np.int32(w < 0) & np.int32(w != MINUS_NOUGHT)))
        stray += (1 - counted) & np.int32(w != 0)
        least = min(least, w | ((usable - 1) & INFINITE))
        largest = max(largest, w & -usable)
    counts[0], counts[1], counts[2] = used, odd, stray
    extremes[0], extremes[1] = least, largest
