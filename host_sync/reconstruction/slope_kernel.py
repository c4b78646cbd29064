"""The inverse map at every pixel in one pass over memory: the workstation's form of `InverseMap.gradients`.

Along one row the position is a polynomial in the column alone, so that a row first folds its own place into the
coefficients. Pixels are taken in short runs (`slope_run`). Rows are independent: the result is the same with any number
of threads.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit, prange

from device.inverse_map import CLIPPED_CONFIDENCE, LOST_EXCESS, InverseMap
from device.photometry import IntensityImage
from device.polynomials import position_exponents
from device.slope_curve import SlopeCurve
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
    begin,
    load,
    load_light,
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
    light = inverse_map.light
    share = 0.0 if light is None else light.share
    _evaluate(
        np.ascontiguousarray(image.values),
        np.ascontiguousarray(image.valid),
        np.ascontiguousarray(image.clipped),
        _tabled(inverse_map.curve, 1.0 - share),
        _tabled(inverse_map.curve if light is None else light.curve, share),
        _DARK if light is None else light.field.nodes,
        p,
        q,
        weight,
        valid,
    )
    return GradientField(p, q, valid, weight)


class _Curve(NamedTuple):
    """A curve as the kernel reads it.

    limits : float32 array of shape (5, 3): low, high, centre, 1 / scale, and 1 / spread in every channel
    degree, place : its degrees in colour and in position
    coefficients : by powers of column and row position, times the curve's share: float32 array of shape (M, 3, 3, 2)
    """

    limits: Float32Array
    degree: int
    place: int
    coefficients: Float32Array


_DARK: Final = np.zeros((0, 0, 3), np.float32)
"""No light: the map has no curve that reads it."""


def _tabled(curve: SlopeCurve, share: float) -> _Curve:
    colours = curve.colours
    per_spread = np.full(3, 1.0 / colours.spread, np.float32)
    limits = np.stack([colours.low, colours.high, colours.centre, np.float32(1.0) / colours.scale, per_spread])
    table = np.zeros((len(curve.coefficients), POWERS, POWERS, 2), np.float32)
    for term, (i, j) in enumerate(position_exponents(curve.position_degree)):
        table[:, i, j] = np.float32(share) * curve.coefficients[:, term]
    return _Curve(limits, curve.colour_degree, curve.position_degree, table)


@njit(parallel=True, cache=True, fastmath={"contract", "nsz"})
def _evaluate(
    values: Float32Array,
    usable: MaskArray,
    clipped: MaskArray,
    plain: _Curve,
    lit: _Curve,
    light: Float32Array,
    p: Float32Array,
    q: Float32Array,
    weight: Float32Array,
    valid: MaskArray,
) -> None:
    """Fill p, q, weight and valid; `light` by places as `LightField` has it, empty where there is none."""
    rows, columns = p.shape
    for row in prange(rows):
        down = np.float32((2.0 * row + 1.0) / rows - 1.0)
        along = _at_row(plain.coefficients, down)
        light_along = _at_row(lit.coefficients, down)
        here = _light_at_row(light, down)
        run = np.empty((PLANES, RUN), np.float32)
        for start in range(0, columns, RUN):
            count = min(RUN, columns - start)
            begin(start, columns, run)
            if len(light):
                load_light(values, here, row, start, count, columns, run)
                take_variables(run, lit.limits)
                add_polynomial(run, lit.degree, lit.place, light_along)
            load(values, row, start, count, run)
            take_variables(run, plain.limits)
            add_polynomial(run, plain.degree, plain.place, along)
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


@njit(cache=True)
def _light_at_row(light: Float32Array, down: np.float32) -> Float32Array:
    """Light of untouched skin along one row: float32 array of shape (n, 3), empty where there is none."""
    if len(light) == 0:
        return np.zeros((0, 3), np.float32)
    at = (down + ONE) * np.float32(0.5 * (len(light) - 1))
    top = min(int(at), len(light) - 2)
    along: Float32Array = light[top] + (at - np.float32(top)) * (light[top + 1] - light[top])
    return along
