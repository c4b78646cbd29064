"""A polynomial in three colours for a run of pixels, by Horner's scheme written out.

Terms stand in the order of `colour_exponents`: by the power of the first colour, then of the second, then of the third.
A polynomial of degree n in (x, y, z) is a plane of degree n in (y, z) plus x times a polynomial of degree n - 1; a
plane is a line in z plus y times the next plane. Written out, all of it stays in registers: one multiplication a term,
three loads and one store a pixel. Lower degrees are filled up with zeros to four; what our fits never have, more than
five, loops.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.inverse_map.regressor import RandomFourierFeatures, colour_exponents
from device.surface import Float32Array
from host_sync.integration.smoother import CONTRACT
from host_sync.kernels.jit import njit

MIN_DEGREE: Final = 4
"""Polynomials of a lower degree are tabled as of this one."""


def term_numbers(degree: int) -> list[int]:
    """Return where the terms of a polynomial stand among those of `tabled_degree(degree)`."""
    terms = colour_exponents(tabled_degree(degree))
    return [terms.index(term) for term in colour_exponents(degree)]


def tabled_degree(degree: int) -> int:
    """Return the degree that a polynomial is tabled with."""
    return max(degree, MIN_DEGREE)


@njit(cache=True, fastmath=CONTRACT)
def write_polynomial(degree: int, c: Any, x: Any, y: Any, z: Any, out: Any) -> None:
    """Write the polynomial at every pixel of a run.

    degree : that it is tabled with
    c : float32 array of shape (M,), coefficients
    x, y, z, out : float32 arrays of shape (N,)
    """
    if degree == 4:
        for k in range(out.size):
            out[k] = _solid_4(c, 0, x[k], y[k], z[k])
    elif degree == 5:
        for k in range(out.size):
            out[k] = _solid_5(c, 0, x[k], y[k], z[k])
    else:
        for k in range(out.size):
            out[k] = _any_degree(degree, c, x[k], y[k], z[k])


@njit(cache=True, fastmath=CONTRACT)
def _any_degree(degree: int, c: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the polynomial by Horner's scheme from its last term to its first."""
    at = c.size - 1
    solid = c[at]
    for n in range(1, degree + 1):
        at -= 1
        plane = c[at]
        for m in range(1, n + 1):
            at -= 1
            line = c[at]
            for _ in range(m):
                at -= 1
                line = c[at] + z * line
            plane = line + y * plane
        solid = plane + x * solid
    return solid


@njit(inline="always")
def _line_1(c: Any, t: int, z: Any) -> Any:
    return c[t] + z * c[t + 1]


@njit(inline="always")
def _line_2(c: Any, t: int, z: Any) -> Any:
    return c[t] + z * _line_1(c, t + 1, z)


@njit(inline="always")
def _line_3(c: Any, t: int, z: Any) -> Any:
    return c[t] + z * _line_2(c, t + 1, z)


@njit(inline="always")
def _line_4(c: Any, t: int, z: Any) -> Any:
    return c[t] + z * _line_3(c, t + 1, z)


@njit(inline="always")
def _line_5(c: Any, t: int, z: Any) -> Any:
    return c[t] + z * _line_4(c, t + 1, z)


@njit(inline="always")
def _plane_1(c: Any, t: int, y: Any, z: Any) -> Any:
    return _line_1(c, t, z) + y * c[t + 2]


@njit(inline="always")
def _plane_2(c: Any, t: int, y: Any, z: Any) -> Any:
    return _line_2(c, t, z) + y * _plane_1(c, t + 3, y, z)


@njit(inline="always")
def _plane_3(c: Any, t: int, y: Any, z: Any) -> Any:
    return _line_3(c, t, z) + y * _plane_2(c, t + 4, y, z)


@njit(inline="always")
def _plane_4(c: Any, t: int, y: Any, z: Any) -> Any:
    return _line_4(c, t, z) + y * _plane_3(c, t + 5, y, z)


@njit(inline="always")
def _plane_5(c: Any, t: int, y: Any, z: Any) -> Any:
    return _line_5(c, t, z) + y * _plane_4(c, t + 6, y, z)


@njit(inline="always")
def _solid_4(c: Any, t: int, x: Any, y: Any, z: Any) -> Any:
    """From the plane without x, of 15 terms, to x⁴'s single term."""
    last = _plane_1(c, t + 31, y, z) + x * c[t + 34]
    return _plane_4(c, t, y, z) + x * (_plane_3(c, t + 15, y, z) + x * (_plane_2(c, t + 25, y, z) + x * last))


@njit(inline="always")
def _solid_5(c: Any, t: int, x: Any, y: Any, z: Any) -> Any:
    """From the plane without x, of 21 terms, to the solid that x multiplies."""
    return _plane_5(c, t, y, z) + x * _solid_4(c, t + 21, x, y, z)


# The waves of a curve for a run of pixels, by a cosine written out so that the loop becomes vector instructions.

_C0: Final = np.float32(0.99999827)
_C1: Final = np.float32(-19.738913)
_C2: Final = np.float32(64.92749)
_C3: Final = np.float32(-85.264275)
_C4: Final = np.float32(58.774754)
_C5: Final = np.float32(-21.068068)
"""cos 2πr as a polynomial in r², |r| ≤ 1/2, to 2e-6: Chebyshev's of degree 5."""

_HALF: Final = np.float32(0.5)


def tabulated_fourier_terms(waves: RandomFourierFeatures) -> Float32Array:
    """Return the direction and phase in turns: float32 array of shape (4, W)."""
    turns = np.concatenate([waves.direction, waves.phase[None]]) / np.float32(2.0 * np.pi)
    return np.ascontiguousarray(turns, np.float32)


def fourier_factor(waves: RandomFourierFeatures) -> float:
    """Return what coefficients are multiplied by for `add_fourier_terms`, which sums cosines half a turn on."""
    return -waves.amplitude


@njit(cache=True, fastmath=CONTRACT)
def add_fourier_terms(waves: Any, along: Any, x: Any, y: Any, z: Any, across: Any, u: Any, v: Any) -> None:
    """Add the waves times their coefficients, polynomials in the column's position, to both components of a run.

    waves : float32 array of shape (4, W), as tabled
    along : float32 array of shape (2, 3, W), coefficients by component and power of the column's position
    x, y, z, across, u, v : float32 arrays of shape (N,): variables, position, and the sums
    """
    for w in range(waves.shape[1]):
        kx, ky, kz, phase = waves[0, w], waves[1, w], waves[2, w], waves[3, w]
        u0, u1, u2 = along[0, 0, w], along[0, 1, w], along[0, 2, w]
        v0, v1, v2 = along[1, 0, w], along[1, 1, w], along[1, 2, w]
        for k in range(u.size):
            turns = phase + kx * x[k] + ky * y[k] + kz * z[k]
            rest = turns - np.floor(turns) - _HALF
            s = rest * rest
            cosine = _C0 + s * (_C1 + s * (_C2 + s * (_C3 + s * (_C4 + s * _C5))))
            place = across[k]
            u[k] += cosine * (u0 + place * (u1 + place * u2))
            v[k] += cosine * (v0 + place * (v1 + place * v2))
