"""Looks at a gradient field's weights before it is integrated, and tells which kernels it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange

from device.surface import Float32Array, GradientField
from host_sync.errors import IntegrationError

LEAST_SIDE_PX = 3


@dataclass(frozen=True, slots=True, eq=False)
class FieldSurvey:
    """What a gradient field holds.

    weight : float32 array of shape (H, W), nought at holes; None for a full rectangle of equal weights
    holes : number of pixels without a height
    largest : largest weight
    """

    weight: Float32Array | None
    holes: int
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
    weight = np.ascontiguousarray(gradients.weight, np.float32)
    counts, extremes = _survey_rows(gradients.valid, weight)
    used, odd, stray = (int(count) for count in counts.sum(axis=0))
    if odd:
        raise IntegrationError(f"{odd} valid pixels have a negative or no finite weight: mark them as not valid")
    if used == 0:
        raise IntegrationError(
            "no pixel of the gradient field is valid: nothing can be integrated, take the scan again"
        )
    holes, smallest, largest = weight.size - used, extremes[:, 0].min(), float(extremes[:, 1].max())
    if holes == 0 and smallest == largest:
        return FieldSurvey(None, 0, largest)
    return FieldSurvey(np.where(gradients.valid, weight, np.float32(0.0)) if stray else weight, holes, largest)


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
    raise IntegrationError("the slopes are too large to be integrated in single precision: check their unit")


@njit(cache=True, parallel=True)
def _survey_rows(valid: Any, weight: Any) -> tuple[Any, Any]:
    """Per row: pixels used, valid ones without a proper weight, others with a weight; least and largest weight used."""
    rows = valid.shape[0]
    counts, extremes = np.zeros((rows, 3), np.int32), np.zeros((rows, 2), np.float32)
    for r in prange(rows):
        _survey_row(valid[r], weight[r], counts[r], extremes[r])
    return counts, extremes


@njit(cache=True)
def _survey_row(valid: Any, weight: Any, counts: Any, extremes: Any) -> None:
    """Write the figures of one row; w - w is nought for finite w alone."""
    nought, infinite = np.float32(0.0), np.float32(np.inf)
    used, odd, stray = np.int32(0), np.int32(0), np.int32(0)
    least, largest = infinite, nought
    for c in range(valid.size):
        w, counts_in = weight[c], valid[c]
        usable = counts_in & (w > nought)
        proper = (w >= nought) & ((w - w) == nought)
        used += np.int32(usable)
        odd += np.int32(counts_in & (not proper))
        stray += np.int32((not counts_in) & (w != nought))
        least = min(least, w if usable else infinite)
        largest = max(largest, w if usable else nought)
    counts[0], counts[1], counts[2] = used, odd, stray
    extremes[0], extremes[1] = least, largest
