"""The inverse map at every pixel in one pass over memory: the workstation's form of `InverseMap.gradients`.

Along one row the position is a polynomial in the column alone, so that a row first folds its own place into the
coefficients. Pixels are taken in short runs (`slope_run`). Rows are independent: the result is the same with any number
of threads.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit, prange

from device.colour_space import ColourSpace
from device.inverse_map import CLIPPED_CONFIDENCE, LOST_EXCESS, InverseMap
from device.photometry import IntensityImage
from device.polynomials import position_exponents
from device.surface import Float32Array, GradientField, MaskArray
from host_sync.reconstruction.slope_run import (
    EXCESS,
    ONE,
    PLANES,
    RUN,
    SLOPE,
    TRUST,
    ZERO,
    add_polynomial,
    load,
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
    p, q, weight = (np.empty(image.shape, np.float32) for _ in range(3))
    valid = np.empty(image.shape, np.bool_)
    _evaluate(
        np.ascontiguousarray(image.values),
        np.ascontiguousarray(image.valid),
        np.ascontiguousarray(image.clipped),
        _limits(inverse_map.colours),
        inverse_map.colour_degree,
        inverse_map.position_degree,
        _coefficients(inverse_map),
        p,
        q,
        weight,
        valid,
    )
    return GradientField(p, q, valid, weight)


def _limits(colours: ColourSpace) -> Float32Array:
    """Float32 array of shape (5, 3): low, high, centre, 1 / scale, and 1 / spread in every channel."""
    per_spread = np.full(3, 1.0 / colours.spread, np.float32)
    return np.stack([colours.low, colours.high, colours.centre, np.float32(1.0) / colours.scale, per_spread])


def _coefficients(inverse_map: InverseMap) -> Float32Array:
    """Coefficients by powers of column and row position: float32 array of shape (M, 3, 3, 2)."""
    table = np.zeros((len(inverse_map.coefficients), POWERS, POWERS, 2), np.float32)
    for term, (i, j) in enumerate(position_exponents(inverse_map.position_degree)):
        table[:, i, j] = inverse_map.coefficients[:, term]
    return table


@njit(parallel=True, cache=True, fastmath={"contract", "nsz"})
def _evaluate(
    values: Float32Array,
    usable: MaskArray,
    clipped: MaskArray,
    limits: Float32Array,
    degree: int,
    place: int,
    coefficients: Float32Array,
    p: Float32Array,
    q: Float32Array,
    weight: Float32Array,
    valid: MaskArray,
) -> None:
    """Fill p, q, weight and valid."""
    rows, columns = p.shape
    for row in prange(rows):
        along = _at_row(coefficients, np.float32((2.0 * row + 1.0) / rows - 1.0))
        run = np.empty((PLANES, RUN), np.float32)
        for start in range(0, columns, RUN):
            count = min(RUN, columns - start)
            load(values, row, start, count, columns, run)
            take_variables(run, limits)
            add_polynomial(run, degree, place, along)
            take_slopes(run)
            take_trust(run)
            for k in range(count):
                column = start + k
                p[row, column] = run[SLOPE, k]
                q[row, column] = run[SLOPE + 1, k]
                known = usable[row, column] and run[EXCESS, k] < np.float32(LOST_EXCESS)
                trust = run[TRUST, k] if known else ZERO
                weight[row, column] = trust * np.float32(CLIPPED_CONFIDENCE) if clipped[row, column] else trust
                valid[row, column] = known


@njit(cache=True)
def _at_row(coefficients: Float32Array, down: np.float32) -> Float32Array:
    """Coefficients at one row: float32 array of shape (M, 3, 2) by powers of the column's position."""
    terms = len(coefficients)
    along = np.zeros((terms, POWERS, 2), np.float32)
    for term in range(terms):
        for i in range(POWERS):
            power = ONE
            for j in range(POWERS):
                along[term, i, 0] += power * coefficients[term, i, j, 0]
                along[term, i, 1] += power * coefficients[term, i, j, 1]
                power *= down
    return along
