"""Checks a gradient field once, before it is integrated, and tells which kernels it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange

from device.surface import GradientField
from host_sync.errors import IntegrationError

LEAST_SIDE_PX = 3


@dataclass(frozen=True, slots=True)
class FieldSurvey:
    """What a gradient field holds.

    holes : number of pixels without a height
    weighted : whether edges differ in weight; a full rectangle of equal weights does not need any
    """

    holes: int
    weighted: bool


def survey(gradients: GradientField) -> FieldSurvey:
    """What the field holds.

    Raises
    ------
    IntegrationError
        Shapes differ or are too small, a valid pixel has no finite slope or weight, or no pixel is valid.
    """
    shape = gradients.valid.shape
    if any(part.shape != shape for part in (gradients.p, gradients.q, gradients.weight)):
        shapes = ", ".join(f"{n} {getattr(gradients, n).shape}" for n in ("p", "q", "valid", "weight"))
        raise IntegrationError(f"the parts of the gradient field differ in shape ({shapes}): give arrays of one (H, W)")
    if len(shape) != 2 or min(shape) < LEAST_SIDE_PX:
        raise IntegrationError(f"a gradient field of shape {shape} is too small: integration needs 3x3 pixels or more")
    weight = np.asarray(gradients.weight, np.float32)
    first = np.float32(weight.flat[np.argmax(gradients.valid)])
    used, faulty, odd, others = _survey_rows(gradients.p, gradients.q, gradients.valid, weight, first)
    if odd.any():
        raise IntegrationError(f"{odd.sum()} valid pixels have a negative or no finite weight: mark them as not valid")
    if faulty.any():
        raise IntegrationError(
            f"{faulty.sum()} valid pixels have no finite slope, the first in row {np.flatnonzero(faulty)[0]}: "
            "mark them as not valid"
        )
    count = int(used.sum())
    if count == 0:
        raise IntegrationError(
            "no pixel of the gradient field is valid: nothing can be integrated, take the scan again"
        )
    holes = gradients.valid.size - count
    return FieldSurvey(holes, holes > 0 or bool(others.any()))


@njit(cache=True, parallel=True)
def _survey_rows(p: Any, q: Any, valid: Any, weight: Any, first: Any) -> Any:
    """Per row: pixels used, those without a slope, without a proper weight, and that weigh other than `first`."""
    rows = valid.shape[0]
    counts = np.zeros((4, rows), np.int32)
    for r in prange(rows):
        counts[0, r], counts[1, r], counts[2, r], counts[3, r] = _survey_row(p[r], q[r], valid[r], weight[r], first)
    return counts


@njit(cache=True)
def _survey_row(p: Any, q: Any, valid: Any, weight: Any, first: Any) -> tuple[Any, Any, Any, Any]:
    """The figures of one row; x - x is nought for finite x alone."""
    nought = np.float32(0.0)
    used, faulty, odd, others = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
    for c in range(p.size):
        w, counts = weight[c], valid[c]
        usable = counts & (w > nought)
        finite = ((p[c] - p[c]) == nought) & ((q[c] - q[c]) == nought)
        proper = (w >= nought) & ((w - w) == nought)
        used += np.int32(usable)
        faulty += np.int32(usable & (not finite))
        odd += np.int32(counts & (not proper))
        others += np.int32(usable & (w != first))
    return used, faulty, odd, others
