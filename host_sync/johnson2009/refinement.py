"""One candidate of one pixel: its Hessian error, refined slope and confidence (paper, eqs. 4 to 8).

Refinement inverts the first-order Taylor series of the reflectance, R(p, q) ≈ R(p0, q0) + J (p - p0, q - q0)ᵀ, by J⁺ =
(JᵀJ + λI)⁻¹Jᵀ; Tikhonov's λ keeps the step small where the reflectance hardly changes with slope.

Differentiating I = R(p, q) gives [∂I/∂x ∂I/∂y] = J H with H the symmetric Hessian of the height. ε² is the part of the
intensity gradients that its symmetrized estimate does not explain. It selects among the slopes of an ambiguous colour
and weights the refinement.

The gate is ω = exp(-ε²/σ²). Equation 8 is printed without the minus sign, so that ω grows with the error, while the
sentence above it says that large errors fall back to the coarse estimate.

The confidence is not in the paper: it measures how uncertain a slope is. It affects neither the selection among
candidates, which uses ε alone, nor the paper's integration, which weights all pixels equally.

Functions are scalar, on floats and tuples, without branches, so the loop that calls them compiles to SIMD code. A
candidate c holds p, q, R (3) and J by rows (6).
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from host_sync.kernels.jit import njit

FAST: Final = {"contract", "arcp", "nsz"}


class GateSettings(NamedTuple):
    """Constants for judging candidates, numpy float32; intensities are relative to the reference.

    tikhonov : λ of equation 5
    gate : σ² of equation 8
    noise : ε² caused by pixel noise alone; below it confidence is not reduced
    flat_variance : trace of (JᵀJ + λI)⁻¹ of the flat skin
    trusted, lost : distance from the model's colours at which confidence is a quarter, and beyond which a slope is
        invalid
    """

    tikhonov: np.float32
    gate: np.float32
    noise: np.float32
    flat_variance: np.float32
    trusted: np.float32
    lost: np.float32


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def judge_candidate(c: Any, colour: Any, across: Any, down: Any, settings: Any) -> tuple[Any, Any, Any, Any]:
    """(p, q, confidence, ε²) of a candidate at a pixel; among several, the one with the smallest ε² is used.

    c : p, q, R (3) and J by rows (6)
    colour, across, down : intensity of the pixel, its ∂I/∂x and ∂I/∂y, three channels each
    """
    inverse = inverse_gram(c, settings.tikhonov)
    error = hessian_error(c, inverse, across, down)
    error = error if error < np.float32(1e6) else np.float32(1e6)  # the neighbour of a NaN
    away = (colour[0] - c[2], colour[1] - c[3], colour[2] - c[4])
    s, t = pseudo_inverse(c, inverse, away)
    far = misfit(c, s, t, away)
    gate = decay(error / settings.gate)
    unexplained = max(error - settings.noise, np.float32(0.0)) / settings.gate
    return c[0] + gate * s, c[1] + gate * t, _confidence(inverse, far, unexplained, settings), error


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def _confidence(inverse: Any, far: Any, unexplained: Any, settings: Any) -> Any:
    """Confidence relative to flat skin: variance through J⁺, reduced for colours far from the model and unexplained
    gradients."""
    one = np.float32(1.0)
    precision = min(settings.flat_variance / (inverse[0] + inverse[2]), one)
    near = one / (one + far / (settings.trusted * settings.trusted))
    known = one if far < settings.lost * settings.lost else np.float32(0.0)
    return known * precision * near * near / (one + unexplained)


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def inverse_gram(c: Any, tikhonov: Any) -> tuple[Any, Any, Any]:
    """Entries (11, 12, 22) of (JᵀJ + λI)⁻¹ (paper, eq. 5)."""
    a = c[5] * c[5] + c[7] * c[7] + c[9] * c[9] + tikhonov
    b = c[5] * c[6] + c[7] * c[8] + c[9] * c[10]
    d = c[6] * c[6] + c[8] * c[8] + c[10] * c[10] + tikhonov
    scale = np.float32(1.0) / (a * d - b * b)
    return d * scale, -b * scale, a * scale


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def pseudo_inverse(c: Any, inverse: Any, x: Any) -> tuple[Any, Any]:
    """J⁺ x of a vector of three channels (paper, eq. 5)."""
    s = c[5] * x[0] + c[7] * x[1] + c[9] * x[2]
    t = c[6] * x[0] + c[8] * x[1] + c[10] * x[2]
    return inverse[0] * s + inverse[1] * t, inverse[1] * s + inverse[2] * t


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def misfit(c: Any, s: Any, t: Any, x: Any) -> Any:
    """Squared norm of x - J (s, t)ᵀ."""
    u, v = x[0] - c[5] * s - c[6] * t, x[1] - c[7] * s - c[8] * t
    w = x[2] - c[9] * s - c[10] * t
    return u * u + v * v + w * w


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def hessian_error(c: Any, inverse: Any, across: Any, down: Any) -> Any:
    """ε²: the part of the intensity gradients that the symmetrized Hessian does not explain (paper, eqs. 6 and 7)."""
    h11, h21 = pseudo_inverse(c, inverse, across)
    h12, h22 = pseudo_inverse(c, inverse, down)
    both = np.float32(0.5) * (h12 + h21)
    return misfit(c, h11, both, across) + misfit(c, both, h22, down)


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def decay(x: Any) -> Any:
    """exp(-x) for x >= 0 within 1e-5: the eighth power of a short series, which compiles to SIMD code."""
    z, one = min(x * np.float32(0.125), np.float32(2.0)), np.float32(1.0)
    tail = np.float32(1.0 / 6.0) + z * (np.float32(1.0 / 24.0) + z * np.float32(1.0 / 120.0))
    growth = one + z * (one + z * (np.float32(0.5) + z * tail))
    square = growth * growth
    fourth = square * square
    return one / (fourth * fourth)
