"""The inverse map at every pixel in one pass over memory: the workstation's form of `InverseMap.gradients`.

Along one row the position is a polynomial in the column alone, so that a row first folds its own place into the
coefficients. Pixels are taken in short runs (`slope_run`). Rows are independent: the result is the same with any number
of threads.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from device.colour_space import CURVES, ColourSpace
from device.inverse_map import CLIPPED_CONFIDENCE, LOST_EXCESS, InverseMap
from device.photometry import IntensityImage
from device.polynomials import position_exponents
from device.surface import Float32Array, GradientField, MaskArray
from host_sync.reconstruction.slope_run import (
    BEYOND,
    CELL,
    ONE,
    PLANES,
    RUN,
    SLOPE,
    TRUST,
    ZERO,
    add_polynomial,
    load,
    take_cells,
    take_slopes,
    take_trust,
    take_variables,
)

POWERS: Final = 3
"""Powers 0 to 2 of a position variable."""


def evaluate(inverse_map: InverseMap, image: IntensityImage) -> GradientField:
    """Slope, validity and confidence of every pixel of a full-size image, equal to the portable evaluation.

    Raises
    ------
    CalibrationMismatch
        The image is not of the map's field.
    """
    inverse_map.check_size(image.shape)
    members, domain = inverse_map.members, inverse_map.domain
    p, q, weight = (np.empty(image.shape, np.float32) for _ in range(3))
    valid = np.empty(image.shape, np.bool_)
    _evaluate(
        np.ascontiguousarray(image.values),
        np.ascontiguousarray(image.valid),
        np.ascontiguousarray(image.clipped),
        np.array([(CURVES.index(m.colours.curve), m.colour_degree, m.position_degree) for m in members], dtype=np.intp),
        np.stack([_limits(member.colours) for member in members]),
        _coefficients(inverse_map),
        domain.low,
        domain.distance,
        np.array([domain.cell, domain.cell / domain.spread, inverse_map.steepest], np.float32),
        p,
        q,
        weight,
        valid,
    )
    return GradientField(p, q, valid, weight)


def _limits(colours: ColourSpace) -> Float32Array:
    return np.stack([colours.low, colours.high, colours.centre, np.float32(1.0) / colours.scale])


def _coefficients(inverse_map: InverseMap) -> Float32Array:
    """Coefficients times shares: float32 array of shape (members, M, 3, 3, 2) by powers of column and row position."""
    most = max(len(member.coefficients) for member in inverse_map.members)
    padded = np.zeros((len(inverse_map.members), most, POWERS, POWERS, 2), np.float32)
    for own, member in zip(padded, inverse_map.members, strict=True):
        for term, (i, j) in enumerate(position_exponents(member.position_degree)):
            own[: len(member.coefficients), i, j] = member.share * member.coefficients[:, term]
    return padded


@njit(parallel=True, cache=True, fastmath={"contract", "nsz"})
def _evaluate(
    values: Float32Array,
    usable: MaskArray,
    clipped: MaskArray,
    kinds: NDArray[np.intp],
    limits: Float32Array,
    coefficients: Float32Array,
    first: Float32Array,
    distance: Float32Array,
    widths: Float32Array,
    p: Float32Array,
    q: Float32Array,
    weight: Float32Array,
    valid: MaskArray,
) -> None:
    """Fill p, q, weight and valid; `kinds` holds curve, colour degree and position degree of each member."""
    rows, columns = p.shape
    nearest = distance.ravel()
    for row in prange(rows):
        along = _at_row(coefficients, np.float32((2.0 * row + 1.0) / rows - 1.0))
        run = np.empty((PLANES, RUN), np.float32)
        for start in range(0, columns, RUN):
            count = min(RUN, columns - start)
            load(values, row, start, count, columns, run)
            for member in range(len(kinds)):
                take_variables(run, kinds[member, 0], limits[member])
                add_polynomial(run, kinds[member, 1], kinds[member, 2], along[member])
            take_slopes(run, widths[2])
            take_cells(run, first, widths, distance.shape)
            for k in range(RUN):
                run[TRUST, k] = nearest[int(run[CELL, k])] + run[BEYOND, k]
            for k in range(count):
                valid[row, start + k] = usable[row, start + k] and run[TRUST, k] < np.float32(LOST_EXCESS)
            take_trust(run)
            for k in range(count):
                column = start + k
                p[row, column] = run[SLOPE, k]
                q[row, column] = run[SLOPE + 1, k]
                trust = run[TRUST, k] if valid[row, column] else ZERO
                weight[row, column] = trust * np.float32(CLIPPED_CONFIDENCE) if clipped[row, column] else trust


@njit(cache=True)
def _at_row(coefficients: Float32Array, down: np.float32) -> Float32Array:
    """Coefficients at one row: float32 array of shape (members, M, 3, 2) by powers of the column's position."""
    members, terms = coefficients.shape[:2]
    along = np.zeros((members, terms, POWERS, 2), np.float32)
    for member in range(members):
        for term in range(terms):
            for i in range(POWERS):
                power = ONE
                for j in range(POWERS):
                    along[member, term, i, 0] += power * coefficients[member, term, i, j, 0]
                    along[member, term, i, 1] += power * coefficients[member, term, i, j, 1]
                    power *= down
    return along
