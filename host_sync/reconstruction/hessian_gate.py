"""How well the Taylor series fits a pixel's neighbourhood, and the weight that follows (paper, eqs. 6 to 8).

Differentiating I = R(p, q) gives [∂I/∂x ∂I/∂y] = J H with H the Hessian of the height. H is symmetric; what its
symmetrised estimate leaves of the intensity gradients is ε². It chooses among the slopes of an ambiguous colour and
weighs the refinement.

Why a minus sign: equation 8 is printed as ω = exp(ε²/σ²), which grows with the error, while the sentence above it says
that large errors fall back to the coarse estimate and small ones take the linear refinement. So ω = exp(-ε²/σ²).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from host_sync.reconstruction.taylor_refinement import FAST, misfit, pseudo_inverse


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def hessian_error(c: Any, inverse: Any, across: Any, down: Any) -> Any:
    """ε²: what the symmetrised Hessian leaves of the intensity gradients (paper, eqs. 6 and 7)."""
    h11, h21 = pseudo_inverse(c, inverse, across)
    h12, h22 = pseudo_inverse(c, inverse, down)
    both = np.float32(0.5) * (h12 + h21)
    return misfit(c, h11, both, across) + misfit(c, both, h22, down)


@njit(forceinline=True, fastmath=FAST, error_model="numpy")
def decay(x: Any) -> Any:
    """exp(-x) for x >= 0 within 1e-5: the eighth power of a short series, which SIMD code can evaluate."""
    z, one = min(x * np.float32(0.125), np.float32(2.0)), np.float32(1.0)
    tail = np.float32(1.0 / 6.0) + z * (np.float32(1.0 / 24.0) + z * np.float32(1.0 / 120.0))
    growth = one + z * (one + z * (np.float32(0.5) + z * tail))
    square = growth * growth
    fourth = square * square
    return one / (fourth * fourth)
