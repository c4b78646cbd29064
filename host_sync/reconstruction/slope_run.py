"""What happens to a short run of pixels on the way from intensity to slope: planes of one small array.

Every product is a loop over the run, which the compiler turns into vector instructions.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from device.colour_space import CURVES, DARK_OFFSET
from device.inverse_map import TRUSTED_EXCESS, TRUSTED_STEEPER
from device.surface import Float32Array

RUN: Final = 128
"""Pixels of one run: its planes stay in the first-level cache."""

# Planes of a run. Constant numbers of one array of constant shape prove to the compiler that planes do not overlap.
_LIFTED: Final = 0
_LOGS: Final = 3
_VARIABLE: Final = 6
_ACROSS: Final = 9
_FIRST: Final = 10
_SECOND: Final = 11
_PRODUCT: Final = 12
_U: Final = 13
SLOPE: Final = 15
_STEEPER: Final = 17
CELL: Final = 18
BEYOND: Final = 19
TRUST: Final = 20
PLANES: Final = 21

_LOG: Final = CURVES.index("log")
_ROOT: Final = CURVES.index("root")
ZERO: Final = np.float32(0.0)
ONE: Final = np.float32(1.0)


@njit(inline="always")
def load(values: Float32Array, row: int, start: int, count: int, columns: int, run: Float32Array) -> None:
    """Fill a run with intensity and its logarithm, the column's position, and u = 0; past the row's end with 1."""
    for k in range(count):
        run[_LIFTED, k] = max(values[row, start + k, 0], ZERO) + np.float32(DARK_OFFSET)
        run[_LIFTED + 1, k] = max(values[row, start + k, 1], ZERO) + np.float32(DARK_OFFSET)
        run[_LIFTED + 2, k] = max(values[row, start + k, 2], ZERO) + np.float32(DARK_OFFSET)
    for k in range(count, RUN):
        run[_LIFTED, k] = ONE
        run[_LIFTED + 1, k] = ONE
        run[_LIFTED + 2, k] = ONE
    begin, step = np.float32((2.0 * start + 1.0) / columns - 1.0), np.float32(2.0 / columns)
    for k in range(RUN):
        run[_ACROSS, k] = begin + step * np.float32(k)
        run[_U, k] = ZERO
        run[_U + 1, k] = ZERO
        run[_LOGS, k] = _logarithm(run[_LIFTED, k])
        run[_LOGS + 1, k] = _logarithm(run[_LIFTED + 1, k])
        run[_LOGS + 2, k] = _logarithm(run[_LIFTED + 2, k])


@njit(inline="always")
def _logarithm(value: np.float32) -> np.float32:
    """Natural logarithm of a positive number, to 1e-7: log m 2^e = e log 2 + 2 artanh((m - 1) / (m + 1)).

    Written out because a call of the library's logarithm would keep the loop from becoming vector instructions.
    """
    bits = np.float32(value).view(np.int32)
    exponent = (bits - np.int32(0x3F3504F3)) >> np.int32(23)  # of the power of two that leaves 0.7 <= m < 1.4
    mantissa = np.int32(bits - (exponent << np.int32(23))).view(np.float32)
    s = (mantissa - ONE) / (mantissa + ONE)
    square = s * s
    series = np.float32(1 / 7) + square * np.float32(1 / 9)
    series = np.float32(1 / 3) + square * (np.float32(1 / 5) + square * series)
    return np.float32(exponent) * np.float32(0.6931471805599453) + np.float32(2.0) * (s + s * square * series)


@njit(inline="always")
def take_variables(run: Float32Array, curve: int, limits: Float32Array) -> None:
    """Set the variables of a run for a member of this curve; `limits` holds low, high, centre and 1 / scale."""
    for k in range(RUN):
        if curve == _LOG:
            first, second, third = run[_LOGS, k], run[_LOGS + 1, k], run[_LOGS + 2, k]
        else:
            first, second, third = run[_LIFTED, k], run[_LIFTED + 1, k], run[_LIFTED + 2, k]
            if curve == _ROOT:
                first, second, third = np.sqrt(first), np.sqrt(second), np.sqrt(third)
        run[_VARIABLE, k] = (min(max(first, limits[0, 0]), limits[1, 0]) - limits[2, 0]) * limits[3, 0]
        run[_VARIABLE + 1, k] = (min(max(second, limits[0, 1]), limits[1, 1]) - limits[2, 1]) * limits[3, 1]
        run[_VARIABLE + 2, k] = (min(max(third, limits[0, 2]), limits[1, 2]) - limits[2, 2]) * limits[3, 2]


@njit(inline="always")
def add_polynomial(run: Float32Array, degree: int, place: int, along: Float32Array) -> None:
    """Add a member's polynomial to u; monomials in the order of `colour_exponents`, within `joint_terms`."""
    term = 0
    for k in range(RUN):
        run[_FIRST, k] = ONE
    for i in range(degree + 1):
        for k in range(RUN):
            run[_SECOND, k] = run[_FIRST, k]
        for j in range(degree + 1 - i):
            for k in range(RUN):
                run[_PRODUCT, k] = run[_SECOND, k]
            for last in range(degree + 1 - i - j):
                _add_term(run, min(place, degree - i - j - last), along[term])
                term += 1
            for k in range(RUN):
                run[_SECOND, k] *= run[_VARIABLE + 1, k]
        for k in range(RUN):
            run[_FIRST, k] *= run[_VARIABLE, k]


@njit(inline="always")
def _add_term(run: Float32Array, degree: int, along: Float32Array) -> None:
    """Add the present monomial times its coefficient, a polynomial in the column; go on to the next power."""
    p0, p1, p2 = along[0, 0], along[1, 0], along[2, 0]
    q0, q1, q2 = along[0, 1], along[1, 1], along[2, 1]
    if degree == 0:
        for k in range(RUN):
            product = run[_PRODUCT, k]
            run[_U, k] += product * p0
            run[_U + 1, k] += product * q0
            run[_PRODUCT, k] = product * run[_VARIABLE + 2, k]
    elif degree == 1:
        for k in range(RUN):
            product, x = run[_PRODUCT, k], run[_ACROSS, k]
            run[_U, k] += product * (p0 + x * p1)
            run[_U + 1, k] += product * (q0 + x * q1)
            run[_PRODUCT, k] = product * run[_VARIABLE + 2, k]
    else:
        for k in range(RUN):
            product, x = run[_PRODUCT, k], run[_ACROSS, k]
            run[_U, k] += product * (p0 + x * (p1 + x * p2))
            run[_U + 1, k] += product * (q0 + x * (q1 + x * q2))
            run[_PRODUCT, k] = product * run[_VARIABLE + 2, k]


@njit(inline="always")
def take_slopes(run: Float32Array, steepest: np.float32) -> None:
    """Slopes from u, and by which multiple of the trusted share they are steeper than what balls taught."""
    for k in range(RUN):
        across, down = run[_U, k], run[_U + 1, k]
        square = across * across + down * down
        rescale = ONE / (ONE - np.float32(0.25) * min(square, np.float32(3.61)))
        run[SLOPE, k] = across * rescale
        run[SLOPE + 1, k] = down * rescale
        share = np.sqrt(square) * rescale / steepest - ONE
        run[_STEEPER, k] = max(share, ZERO) * np.float32(1.0 / TRUSTED_STEEPER)


@njit(inline="always")
def take_cells(run: Float32Array, first: Float32Array, widths: Float32Array, shape: tuple[int, int, int]) -> None:
    """The domain's cell that each colour falls into, and how far beyond the table it lies, standard deviations."""
    last0, last1, last2 = np.float32(shape[0] - 1), np.float32(shape[1] - 1), np.float32(shape[2] - 1)
    low0, low1, low2 = first[0], first[1], first[2]
    per_log, spreads = ONE / widths[0], widths[1]
    half = np.float32(0.5)
    for k in range(RUN):
        at0, at1, at2 = (
            (run[_LOGS, k] - low0) * per_log,
            (run[_LOGS + 1, k] - low1) * per_log,
            (run[_LOGS + 2, k] - low2) * per_log,
        )
        in0, in1, in2 = min(max(at0, ZERO), last0), min(max(at1, ZERO), last1), min(max(at2, ZERO), last2)
        run[BEYOND, k] = max(abs(at0 - in0), max(abs(at1 - in1), abs(at2 - in2))) * spreads
        # Whole numbers under 2^24 are exact.
        cell = np.floor(in0 + half) * (last1 + ONE) + np.floor(in1 + half)
        run[CELL, k] = cell * (last2 + ONE) + np.floor(in2 + half)


@njit(inline="always")
def take_trust(run: Float32Array) -> None:
    """Confidence from the distance to the calibrated colours, which it replaces, and from steepness."""
    for k in range(RUN):
        outside = run[TRUST, k] * np.float32(1.0 / TRUSTED_EXCESS)
        doubt = (ONE + outside * outside) * (ONE + run[_STEEPER, k] * run[_STEEPER, k])
        run[TRUST, k] = ONE / (doubt * doubt)
