"""One candidate of one pixel: its Hessian error, its refined slope and how far to trust it (paper, eqs. 4 to 8).

The gate is exp(-ε²/σ²): equation 8 is printed without the minus sign, but the text under it (large errors fall back to
the coarse estimate) needs it.

These are scalar functions of floats and tuples, without branches, so that the loop which calls them becomes SIMD code.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

_FAST = {"contract", "arcp", "nsz"}


class GateSettings(NamedTuple):
    """Figures that candidates are weighed by, numpy float32; intensities are relative to the reference.

    tikhonov : λ of equation 5
    gate : σ² of equation 8
    noise : ε² that pixel noise alone makes; below it candidates count as equal
    colour : variance of intensity at one slope
    flat_variance : trace of (JᵀJ + λI)⁻¹ of the flat skin
    trusted, lost : distance from the model's colours at which confidence is a quarter, and where a slope means nothing
    """

    tikhonov: np.float32
    gate: np.float32
    noise: np.float32
    colour: np.float32
    flat_variance: np.float32
    trusted: np.float32
    lost: np.float32


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def judge_candidate(c: Any, colour: Any, across: Any, down: Any, settings: Any) -> tuple[Any, Any, Any, Any]:
    """(p, q, confidence, cost) of a candidate at a pixel; the least cost is the best candidate.

    c : p, q, R (3) and J by rows (6)
    colour, across, down : intensity of the pixel, its ∂I/∂x and ∂I/∂y, three channels each
    """
    inverse = _inverse_gram(c, settings.tikhonov)
    error = _hessian_error(c, inverse, across, down)
    error = error if error < np.float32(1e6) else np.float32(1e6)  # beside a pixel that is no number
    away = (colour[0] - c[2], colour[1] - c[3], colour[2] - c[4])
    s, t = _pseudo_inverse(c, inverse, away)
    far = _misfit(c, s, t, away)
    gate = decay(error / settings.gate)
    unexplained = max(error - settings.noise, np.float32(0.0)) / settings.gate
    cost = unexplained + np.float32(0.5) * far / settings.colour
    return c[0] + gate * s, c[1] + gate * t, _confidence(inverse, far, unexplained, settings), cost


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def decay(x: Any) -> Any:
    """exp(-x) for x >= 0 within 1e-5: the eighth power of a short series, which SIMD code can evaluate."""
    z, one = min(x * np.float32(0.125), np.float32(2.0)), np.float32(1.0)
    tail = np.float32(1.0 / 6.0) + z * (np.float32(1.0 / 24.0) + z * np.float32(1.0 / 120.0))
    growth = one + z * (one + z * (np.float32(0.5) + z * tail))
    square = growth * growth
    fourth = square * square
    return one / (fourth * fourth)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _inverse_gram(c: Any, tikhonov: Any) -> tuple[Any, Any, Any]:
    """Entries (11, 12, 22) of (JᵀJ + λI)⁻¹ (paper, eq. 5)."""
    a = c[5] * c[5] + c[7] * c[7] + c[9] * c[9] + tikhonov
    b = c[5] * c[6] + c[7] * c[8] + c[9] * c[10]
    d = c[6] * c[6] + c[8] * c[8] + c[10] * c[10] + tikhonov
    share = np.float32(1.0) / (a * d - b * b)
    return d * share, -b * share, a * share


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _pseudo_inverse(c: Any, inverse: Any, x: Any) -> tuple[Any, Any]:
    """J⁺ x of a vector of three channels (paper, eq. 5)."""
    s = c[5] * x[0] + c[7] * x[1] + c[9] * x[2]
    t = c[6] * x[0] + c[8] * x[1] + c[10] * x[2]
    return inverse[0] * s + inverse[1] * t, inverse[1] * s + inverse[2] * t


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _misfit(c: Any, s: Any, t: Any, x: Any) -> Any:
    """Square of the norm of x - J (s, t)ᵀ."""
    u, v = x[0] - c[5] * s - c[6] * t, x[1] - c[7] * s - c[8] * t
    w = x[2] - c[9] * s - c[10] * t
    return u * u + v * v + w * w


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _hessian_error(c: Any, inverse: Any, across: Any, down: Any) -> Any:
    """ε²: what the symmetrised Hessian leaves of the intensity gradients (paper, eqs. 6 and 7)."""
    h11, h21 = _pseudo_inverse(c, inverse, across)
    h12, h22 = _pseudo_inverse(c, inverse, down)
    both = np.float32(0.5) * (h12 + h21)
    return _misfit(c, h11, both, across) + _misfit(c, both, h22, down)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _confidence(inverse: Any, far: Any, unexplained: Any, settings: Any) -> Any:
    """Confidence relative to the flat skin: variance through J⁺, less for strange colours and unexplained gradients."""
    one = np.float32(1.0)
    precision = min(settings.flat_variance / (inverse[0] + inverse[2]), one)
    near = one / (one + far / (settings.trusted * settings.trusted))
    known = one if far < settings.lost * settings.lost else np.float32(0.0)
    return known * precision * near * near / (one + unexplained)
