"""The V-cycle: smooth, restrict the residual, correct from the next level, interpolate, smooth."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.reconstruction.coarsest import solve_coarsest
from host_sync.reconstruction.grid_level import GridLevel
from host_sync.reconstruction.smoother import chebyshev_steps
from host_sync.reconstruction.sweep import sweep

UNIT_SWEEPS: Final = 2
WEIGHTED_SWEEPS: Final = 3
"""Sweeps before and after the correction; weights and holes leave more that only smoothing removes."""


def v_cycle(levels: list[GridLevel], inverse: Float64Array) -> float:
    """Root mean square, px, of the heights that one cycle from nought finds for the first level's right-hand side.

    They stand in that level's `z`; the right-hand sides of the levels below are overwritten.

    inverse : `pseudo_inverse` of the last level
    """
    level, *rest = levels
    if not rest:
        solve_coarsest(level, inverse)
        return float(np.sqrt(np.mean(np.square(level.z, dtype=np.float64))))
    coarse, steps = rest[0], smoothing(level)
    sweep(level, steps, None, level.spare, coarse_rhs=coarse.rhs)
    v_cycle(rest, inverse)
    return sweep(level, steps, level.spare, level.z, coarse=coarse.z)


def smoothing(level: GridLevel) -> Float32Array:
    """Relaxation factors for a level, float32 array of shape (sweeps,)."""
    return chebyshev_steps(UNIT_SWEEPS if level.across is None else WEIGHTED_SWEEPS)
