"""Steps from intensity to slope for a short run of pixels: planes of one small array.

Every step is a loop over the run, which the compiler turns into vector instructions.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.inverse_map.model import DISAGREEMENT, REST_WIDTH, TRUSTED_EXCESS
from device.inverse_map.near_light import MIN_BRIGHTNESS
from device.inverse_map.regressor import DARK_OFFSET
from device.surface import Float32Array
from host_sync.gradients.polynomial_kernel import add_fourier_terms, write_polynomial
from host_sync.kernels.jit import njit

RUN: Final = 512
"""Most pixels of a run: its planes stay in the first-level cache."""

LANES: Final = 16
"""Pixels of one vector instruction; runs are as long as a multiple of it."""

_COLOURS: Final = 0
_ACROSS: Final = 3
_POLYNOMIAL: Final = 4
_U: Final = 7
EXCESS: Final = 9
SLOPE: Final = 10
TRUST: Final = 12
_SUM: Final = 13
_SQUARE: Final = 15
PLANES: Final = 16

ZERO: Final = np.float32(0.0)
ONE: Final = np.float32(1.0)
_CONTRACT: Final = {"contract", "nsz"}


@njit(cache=True)
def run_length(columns: int) -> int:
    """Return the length of the runs that a row is worked off in: as few and as even as may be."""
    runs = (columns + RUN - 1) // RUN
    return (columns + runs * LANES - 1) // (runs * LANES) * LANES


@njit(cache=True, fastmath=_CONTRACT)
def begin(start: int, columns: int, run: Any) -> None:
    """Write the columns' position."""
    first, step = np.float32((2.0 * start + 1.0) / columns - 1.0), np.float32(2.0 / columns)
    across = run[_ACROSS]
    for k in range(across.size):
        across[k] = first + step * np.float32(k)


@njit(cache=True, fastmath=_CONTRACT, error_model="numpy")
def load(colours: Any, run: Any) -> None:
    """Write the logarithm of intensity, three float32 arrays of shape (n,); past the row's end as if 1 stood."""
    for channel in range(3):
        values, out = colours[channel], run[_COLOURS + channel]
        for k in range(values.size):
            out[k] = max(values[k], ZERO) + np.float32(DARK_OFFSET)
        out[values.size :] = ONE
        for k in range(out.size):
            out[k] = _logarithm(out[k])


@njit(cache=True, fastmath=_CONTRACT)
def load_light(colours: Any, start: int, above: Any, below: Any, share: Any, run: Any) -> None:
    """Write light: intensity times the light of untouched skin; past the row's end as if 1 stood.

    start : the run's first column
    above, below : float32 arrays of shape (3, W), light along the rows of places next to this row
    share : of the way from one to the other
    """
    for channel in range(3):
        values, out = colours[channel], run[_COLOURS + channel]
        upper, lower = above[channel, start:], below[channel, start:]
        for k in range(values.size):
            here = upper[k] + share * (lower[k] - upper[k])
            out[k] = values[k] * here
        out[values.size :] = ONE


@njit(cache=True, error_model="numpy")
def load_root(colours: Any, run: Any) -> None:
    """Write the root of intensity; past the row's end as if 1 stood."""
    for channel in range(3):
        values, out = colours[channel], run[_COLOURS + channel]
        for k in range(values.size):
            out[k] = np.sqrt(max(values[k], ZERO))
        out[values.size :] = ONE


@njit(cache=True, fastmath=_CONTRACT)
def begin_below_rest(start: int, above: Any, below: Any, share: Any, run: Any) -> None:
    """Write minus what a curve reads on untouched skin as the stereographic slope that it is added to.

    start : the run's first column
    above, below : float32 arrays of shape (2, W), minus that reading along the rows of places next to this row
    share : of the way from one to the other
    """
    for component in range(2):
        upper, lower, out = above[component, start:], below[component, start:], run[_U + component]
        for k in range(min(out.size, upper.size)):
            out[k] = upper[k] + share * (lower[k] - upper[k])
        out[upper.size :] = ZERO


@njit(cache=True)
def begin_at_zero(run: Any) -> None:
    """Write zero as the stereographic slope that a curve is added to."""
    run[_U : _U + 2] = ZERO


@njit(cache=True, fastmath=_CONTRACT)
def take_off_bias(start: int, above: Any, below: Any, share: Any, run: Any) -> None:
    """Add minus the bias to the curves' mean; arguments as for `begin_below_rest`."""
    for component in range(2):
        upper, lower, out = above[component, start:], below[component, start:], run[_SUM + component]
        for k in range(min(out.size, upper.size)):
            out[k] += upper[k] + share * (lower[k] - upper[k])


@njit(cache=True, fastmath=_CONTRACT, error_model="numpy")
def take_off_bump(colours: Any, start: int, above: Any, below: Any, share: Any, run: Any) -> None:
    """Take what is read of untouched skin off the curves' mean, as much as a pixel looks untouched.

    `rest_likeness` states how much that is; `above` and `below` hold minus what is read.

    colours : three float32 arrays of shape (n,), intensity
    """
    red, green, blue = colours
    across, down = run[_SUM], run[_SUM + 1]
    for k in range(red.size):
        i0, i1, i2 = red[k] - ONE, green[k] - ONE, blue[k] - ONE
        likeness = ONE + (i0 * i0 + i1 * i1 + i2 * i2) * np.float32(1.0 / REST_WIDTH**2)
        likeness = ONE / (likeness * likeness)
        at = start + k
        across[k] += likeness * (above[0, at] + share * (below[0, at] - above[0, at]))
        down[k] += likeness * (above[1, at] + share * (below[1, at] - above[1, at]))


@njit(cache=True, fastmath=_CONTRACT)
def take_off_noise(seen: Any, shrunk: Any, here: Any, across: Any, limit: np.float32, run: Any) -> None:
    """Take off the curves' mean the noise along the null colour (`NullColour.noise`).

    seen, shrunk : three float32 arrays of shape (n,) each, intensity as seen and with its noise shrunk
    here, across : float32 arrays of shape (5, 3), three channels and two slopes by terms of slope, at the middle of
        this row and what a step of the column's position adds
    limit : as of `NullColour`
    """
    red, green, blue = seen
    quiet_red, quiet_green, quiet_blue = shrunk
    first, second, column = run[_SUM], run[_SUM + 1], run[_ACROSS]
    for k in range(red.size):
        x, u, v = column[k], min(max(first[k], -limit), limit), min(max(second[k], -limit), limit)
        residual = (red[k] - quiet_red[k]) * _plane(here[0], across[0], x, u, v)
        residual += (green[k] - quiet_green[k]) * _plane(here[1], across[1], x, u, v)
        residual += (blue[k] - quiet_blue[k]) * _plane(here[2], across[2], x, u, v)
        first[k] -= residual * _plane(here[3], across[3], x, u, v)
        second[k] -= residual * _plane(here[4], across[4], x, u, v)


@njit(inline="always")
def _plane(here: Any, across: Any, x: Any, u: Any, v: Any) -> Any:
    return here[0] + x * across[0] + u * (here[1] + x * across[1]) + v * (here[2] + x * across[2])


@njit(cache=True, fastmath=_CONTRACT, error_model="numpy")
def load_near(colours: Any, near: Any, least: np.float32, run: Any) -> None:
    """Write p, q and brightness of a matt skin under near lights (`NearLightModel.seen`); 1 beyond the row's end.

    near : float32 array of shape (2, 3, 4), the lights' directions by component, channel and power of the column
    least : as of `NearLightModel.min_volume`
    """
    red, green, blue = colours
    sign = ONE if least > ZERO else -ONE
    least = sign * least
    p, q, brightness, across = run[_COLOURS], run[_COLOURS + 1], run[_COLOURS + 2], run[_ACROSS]
    for k in range(red.size):
        i0, i1, i2, x = red[k], green[k], blue[k], across[k]
        a0, a1, a2 = _at(near[0, 0], x), _at(near[0, 1], x), _at(near[0, 2], x)
        b0, b1, b2 = _at(near[1, 0], x), _at(near[1, 1], x), _at(near[1, 2], x)
        v0, v1, v2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
        whole = v0 + v1 + v2
        whole = sign * max(sign * whole, least)
        brighter = (i0 - ONE) * v0 + (i1 - ONE) * v1 + (i2 - ONE) * v2
        bright = max(ONE + brighter / whole, np.float32(MIN_BRIGHTNESS))
        per = ONE / (whole * bright)
        p[k] = (i0 * (b1 - b2) + i1 * (b2 - b0) + i2 * (b0 - b1)) * per
        q[k] = (i0 * (a2 - a1) + i1 * (a0 - a2) + i2 * (a1 - a0)) * per
        brightness[k] = bright
    for channel in range(3):
        run[_COLOURS + channel, red.size :] = ONE


@njit(inline="always")
def _at(powers: Any, x: Any) -> Any:
    return powers[0] + x * (powers[1] + x * (powers[2] + x * powers[3]))


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


@njit(cache=True, fastmath=_CONTRACT)
def take_variables(run: Any, limits: Float32Array) -> None:
    """Turn colours into variables, and write how far outside the calibrated colours they lay.

    limits : as the kernel has them
    """
    excess = run[EXCESS]
    for k in range(excess.size):
        excess[k] = ZERO
    for channel in range(3):
        colour = run[_COLOURS + channel]
        low, high, centre, per_scale = limits[0, channel], limits[1, channel], limits[2, channel], limits[3, channel]
        for k in range(colour.size):
            inside = min(max(colour[k], low), high)
            excess[k] = max(excess[k], abs(colour[k] - inside))
            colour[k] = (inside - centre) * per_scale
    per_spread = limits[4, 0]
    for k in range(excess.size):
        excess[k] *= per_spread


@njit(cache=True)
def eval_regressor(run: Any, degree: int, place: int, along: Any) -> None:
    """Add the curve's stereographic slope to what stands there.

    degree, place : its tabled degree in colour, its degree in position
    along : float32 array of shape (2, 3, M), coefficients of u's components by powers of the column's position
    """
    x, y, z, across = run[_COLOURS], run[_COLOURS + 1], run[_COLOURS + 2], run[_ACROSS]
    for component in range(2):
        for power in range(place + 1):
            write_polynomial(degree, along[component, power], x, y, z, run[_POLYNOMIAL + power])
        for power in range(place + 1, 3):
            run[_POLYNOMIAL + power] = ZERO
        first, second, third = run[_POLYNOMIAL], run[_POLYNOMIAL + 1], run[_POLYNOMIAL + 2]
        _add_powers(across, first, second, third, run[_U + component])


@njit(cache=True, fastmath=_CONTRACT)
def gather_u(run: Any, share: Any, first: bool) -> None:
    """Add a curve's u, which holds its share already, to the sum of all curves' and its square to their mean square.

    first : whether it is the first one: what stood in the sums is forgotten
    """
    u_across, u_down, sum_across, sum_down = run[_U], run[_U + 1], run[_SUM], run[_SUM + 1]
    square, per_share = run[_SQUARE], ONE / share
    if first:
        sum_across[:], sum_down[:], square[:] = u_across, u_down, ZERO
    else:
        for k in range(square.size):
            sum_across[k] += u_across[k]
            sum_down[k] += u_down[k]
    for k in range(square.size):
        square[k] += (u_across[k] * u_across[k] + u_down[k] * u_down[k]) * per_share


@njit(cache=True)
def add_fourier_terms_to_u(run: Any, waves: Any, along: Any) -> None:
    """Add the curve's waves to its stereographic slope; arguments as for `add_fourier_terms`."""
    colours = run[_COLOURS], run[_COLOURS + 1], run[_COLOURS + 2]
    add_fourier_terms(waves, along, colours[0], colours[1], colours[2], run[_ACROSS], run[_U], run[_U + 1])


@njit(cache=True, fastmath=_CONTRACT)
def _add_powers(across: Any, first: Any, second: Any, third: Any, out: Any) -> None:
    for k in range(out.size):
        out[k] += first[k] + across[k] * (second[k] + across[k] * third[k])


@njit(cache=True, fastmath=_CONTRACT, error_model="numpy")
def take_slopes(run: Any, largest: Any) -> None:
    """Write slopes from the curves' mean u; steeper ones than at the square of u `largest` are shortened to it."""
    u_across, u_down, p, q = run[_SUM], run[_SUM + 1], run[SLOPE], run[SLOPE + 1]
    for k in range(p.size):
        square = u_across[k] * u_across[k] + u_down[k] * u_down[k]
        rescale = ONE / (ONE - np.float32(0.25) * min(square, largest))
        if square > largest:
            rescale *= np.sqrt(largest / square)
        p[k] = u_across[k] * rescale
        q[k] = u_down[k] * rescale


@njit(cache=True, fastmath=_CONTRACT, error_model="numpy")
def write_confidence(run: Any, curves: int) -> None:
    """Write confidence from the distance to the calibrated colours and, of more than one curve, their disagreement."""
    excess, trust = run[EXCESS], run[TRUST]
    for k in range(trust.size):
        outside = excess[k] * np.float32(1.0 / TRUSTED_EXCESS)
        doubt = ONE + outside * outside
        trust[k] = ONE / (doubt * doubt)
    if curves > 1:
        _take_disagreement(run[_SUM], run[_SUM + 1], run[_SQUARE], trust)


@njit(cache=True, fastmath=_CONTRACT, error_model="numpy")
def _take_disagreement(u_across: Any, u_down: Any, square: Any, trust: Any) -> None:
    for k in range(trust.size):
        spread = max(square[k] - (u_across[k] * u_across[k] + u_down[k] * u_down[k]), ZERO)
        trust[k] /= ONE + spread * np.float32(1.0 / DISAGREEMENT**2)
