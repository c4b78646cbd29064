"""Refinement of a coarse slope by the first-order Taylor series of the reflectance (paper, eqs. 4 and 5).

R(p, q) ≈ R(p0, q0) + J (p - p0, q - q0)ᵀ, inverted by J⁺ = (JᵀJ + λI)⁻¹Jᵀ: Tikhonov's λ keeps the step small where the
reflectance hardly changes with slope.

These are scalar functions of floats and tuples, without branches, so that the loop which calls them becomes SIMD code.
A candidate c holds p, q, R (3) and J by rows (6).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

FAST: Final = {"contract", "arcp", "nsz"}


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def inverse_gram(c: Any, tikhonov: Any) -> tuple[Any, Any, Any]:
    """Entries (11, 12, 22) of (JᵀJ + λI)⁻¹ (paper, eq. 5)."""
    a = c[5] * c[5] + c[7] * c[7] + c[9] * c[9] + tikhonov
    b = c[5] * c[6] + c[7] * c[8] + c[9] * c[10]
    d = c[6] * c[6] + c[8] * c[8] + c[10] * c[10] + tikhonov
    share = np.float32(1.0) / (a * d - b * b)
    return d * share, -b * share, a * share


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def pseudo_inverse(c: Any, inverse: Any, x: Any) -> tuple[Any, Any]:
    """J⁺ x of a vector of three channels (paper, eq. 5)."""
    s = c[5] * x[0] + c[7] * x[1] + c[9] * x[2]
    t = c[6] * x[0] + c[8] * x[1] + c[10] * x[2]
    return inverse[0] * s + inverse[1] * t, inverse[1] * s + inverse[2] * t


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def misfit(c: Any, s: Any, t: Any, x: Any) -> Any:
    """Square of the norm of x - J (s, t)ᵀ."""
    u, v = x[0] - c[5] * s - c[6] * t, x[1] - c[7] * s - c[8] * t
    w = x[2] - c[9] * s - c[10] * t
    return u * u + v * v + w * w
