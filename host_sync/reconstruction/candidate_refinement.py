"""One candidate of one pixel: its Hessian error, its refined slope and how far to trust it (paper, eq. 8).

The confidence is ours: it tells how uncertain a slope is. It takes part neither in the choice among candidates, which
is by ε alone, nor in the paper's integration, which weighs all pixels alike.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from host_sync.reconstruction.hessian_gate import decay, hessian_error
from host_sync.reconstruction.taylor_refinement import FAST, inverse_gram, misfit, pseudo_inverse


class GateSettings(NamedTuple):
    """Figures that candidates are weighed by, numpy float32; intensities are relative to the reference.

    tikhonov : λ of equation 5
    gate : σ² of equation 8
    noise : ε² that pixel noise alone makes; below it confidence is whole
    flat_variance : trace of (JᵀJ + λI)⁻¹ of the flat skin
    trusted, lost : distance from the model's colours at which confidence is a quarter, and where a slope means nothing
    """

    tikhonov: np.float32
    gate: np.float32
    noise: np.float32
    flat_variance: np.float32
    trusted: np.float32
    lost: np.float32


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def judge_candidate(c: Any, colour: Any, across: Any, down: Any, settings: Any) -> tuple[Any, Any, Any, Any]:
    """(p, q, confidence, ε²) of a candidate at a pixel; of several the one of least ε² is taken.

    c : p, q, R (3) and J by rows (6)
    colour, across, down : intensity of the pixel, its ∂I/∂x and ∂I/∂y, three channels each
    """
    inverse = inverse_gram(c, settings.tikhonov)
    error = hessian_error(c, inverse, across, down)
    error = error if error < np.float32(1e6) else np.float32(1e6)  # beside a pixel that is no number
    away = (colour[0] - c[2], colour[1] - c[3], colour[2] - c[4])
    s, t = pseudo_inverse(c, inverse, away)
    far = misfit(c, s, t, away)
    gate = decay(error / settings.gate)
    unexplained = max(error - settings.noise, np.float32(0.0)) / settings.gate
    return c[0] + gate * s, c[1] + gate * t, _confidence(inverse, far, unexplained, settings), error


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def _confidence(inverse: Any, far: Any, unexplained: Any, settings: Any) -> Any:
    """Confidence relative to the flat skin: variance through J⁺, less for strange colours and unexplained gradients."""
    one = np.float32(1.0)
    precision = min(settings.flat_variance / (inverse[0] + inverse[2]), one)
    near = one / (one + far / (settings.trusted * settings.trusted))
    known = one if far < settings.lost * settings.lost else np.float32(0.0)
    return known * precision * near * near / (one + unexplained)
