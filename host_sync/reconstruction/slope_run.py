"""What happens to a short run of pixels on the way from intensity to slope: planes of one small array.

Every product is a loop over the run, which the compiler turns into vector instructions.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from device.colour_space import DARK_OFFSET
from device.inverse_map import TRUSTED_EXCESS
from device.surface import Float32Array

RUN: Final = 128
"""Pixels of one run: its planes stay in the first-level cache."""

# Planes of a run. Constant numbers of one array of constant shape prove to the compiler that planes do not overlap.
_COLOURS: Final = 0
_VARIABLE: Final = 3
_ACROSS: Final = 6
_FIRST: Final = 7
_SECOND: Final = 8
_PRODUCT: Final = 9
_U: Final = 10
SLOPE: Final = 12
EXCESS: Final = 14
TRUST: Final = 15
PLANES: Final = 16

ZERO: Final = np.float32(0.0)
ONE: Final = np.float32(1.0)


@njit(inline="always")
def begin(start: int, columns: int, run: Float32Array) -> None:
    """Set the columns' position and u = 0."""
    begin, step = np.float32((2.0 * start + 1.0) / columns - 1.0), np.float32(2.0 / columns)
    for k in range(RUN):
        run[_ACROSS, k] = begin + step * np.float32(k)
        run[_U, k] = ZERO
        run[_U + 1, k] = ZERO


@njit(inline="always")
def load(values: Float32Array, row: int, start: int, count: int, run: Float32Array) -> None:
    """Fill a run with the logarithm of intensity; past the row's end as if 1 stood."""
    for k in range(count):
        for channel in range(3):
            run[_COLOURS + channel, k] = max(values[row, start + k, channel], ZERO) + np.float32(DARK_OFFSET)
    for k in range(count, RUN):
        run[_COLOURS, k] = ONE
        run[_COLOURS + 1, k] = ONE
        run[_COLOURS + 2, k] = ONE
    for k in range(RUN):
        run[_COLOURS, k] = _logarithm(run[_COLOURS, k])
        run[_COLOURS + 1, k] = _logarithm(run[_COLOURS + 1, k])
        run[_COLOURS + 2, k] = _logarithm(run[_COLOURS + 2, k])


@njit(inline="always")
def load_light(
    values: Float32Array, light: Float32Array, row: int, start: int, count: int, columns: int, run: Float32Array
) -> None:
    """Fill a run with light: intensity times the light of untouched skin; past the row's end as if 1 stood.

    light : float32 array of shape (n, 3), along the row, from its left to its right border
    """
    last = len(light) - 1
    per_column = np.float32(last) / np.float32(columns)
    for k in range(count):
        at = (np.float32(start + k) + np.float32(0.5)) * per_column
        left = min(int(at), last - 1)
        share = at - np.float32(left)
        for channel in range(3):
            here = light[left, channel] + share * (light[left + 1, channel] - light[left, channel])
            run[_COLOURS + channel, k] = max(values[row, start + k, channel], ZERO) * here
    for k in range(count, RUN):
        run[_COLOURS, k] = ONE
        run[_COLOURS + 1, k] = ONE
        run[_COLOURS + 2, k] = ONE


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
def take_variables(run: Float32Array, limits: Float32Array) -> None:
    """Variables, and how far outside the calibrated colours they lay; `limits` as the kernel has them."""
    for k in range(RUN):
        excess = ZERO
        first, second, third = run[_COLOURS, k], run[_COLOURS + 1, k], run[_COLOURS + 2, k]
        inside = min(max(first, limits[0, 0]), limits[1, 0])
        excess = max(excess, abs(first - inside))
        run[_VARIABLE, k] = (inside - limits[2, 0]) * limits[3, 0]
        inside = min(max(second, limits[0, 1]), limits[1, 1])
        excess = max(excess, abs(second - inside))
        run[_VARIABLE + 1, k] = (inside - limits[2, 1]) * limits[3, 1]
        inside = min(max(third, limits[0, 2]), limits[1, 2])
        excess = max(excess, abs(third - inside))
        run[_VARIABLE + 2, k] = (inside - limits[2, 2]) * limits[3, 2]
        run[EXCESS, k] = excess * limits[4, 0]


@njit(inline="always")
def add_polynomial(run: Float32Array, degree: int, place: int, along: Float32Array) -> None:
    """Add the polynomial to u; monomials in the order of `colour_exponents`, `place` its degree in position."""
    term = 0
    for k in range(RUN):
        run[_FIRST, k] = ONE
    for i in range(degree + 1):
        for k in range(RUN):
            run[_SECOND, k] = run[_FIRST, k]
        for j in range(degree + 1 - i):
            for k in range(RUN):
                run[_PRODUCT, k] = run[_SECOND, k]
            for _ in range(degree + 1 - i - j):
                _add_term(run, place, along[term])
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
def take_slopes(run: Float32Array) -> None:
    """Slopes from u."""
    for k in range(RUN):
        across, down = run[_U, k], run[_U + 1, k]
        square = across * across + down * down
        rescale = ONE / (ONE - np.float32(0.25) * min(square, np.float32(3.61)))
        run[SLOPE, k] = across * rescale
        run[SLOPE + 1, k] = down * rescale


@njit(inline="always")
def take_trust(run: Float32Array) -> None:
    """Confidence from the distance to the calibrated colours."""
    for k in range(RUN):
        outside = run[EXCESS, k] * np.float32(1.0 / TRUSTED_EXCESS)
        doubt = ONE + outside * outside
        run[TRUST, k] = ONE / (doubt * doubt)
