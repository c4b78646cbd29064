"""The V-cycle: smooth, restrict the residual, correct from the next level, interpolate, smooth."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from device.surface.fields import Float32Array
from host_sync.integration.coarse_solver import DirectSolver
from host_sync.integration.error_estimate import geometric_tail
from host_sync.integration.levels import GridLevel
from host_sync.integration.smoother import chebyshev_steps
from host_sync.integration.sweep import root_mean_square, sweep

SWEEPS: Final = 2
"""Sweeps before and after the correction."""


def v_cycle(levels: list[GridLevel], solve: DirectSolver, after: int = 1) -> None:
    """Write to the first level's `z` the heights that one cycle, started from zero, finds for its right-hand side.

    The right-hand sides of coarser levels are overwritten.

    solve : `direct_solver` of the last level
    after : how often the first level is smoothed after its correction; 0 where only the pixels are finer, for which its
        roughness is too small to matter
    """
    level, *rest = levels
    if not rest:
        solve(level)
        return
    coarse, steps = rest[0], smoothing()
    sweep(level, steps, None, level.spare, coarse_rhs=coarse.rhs)
    level.swap()
    v_cycle(rest, solve)
    sweep(level, smoothing(after), level.z, level.spare, coarse=coarse.z)
    level.swap()


def nested_cycles(levels: list[GridLevel], solve: DirectSolver, cycles: int, after: int = 1) -> float:
    """Solve the first level from the heights of the next one: add offsets, smooth, improve by V-cycles.

    Returns the estimated remaining error, 0 after fewer than two cycles. The last sweeps of a cycle and the first of
    the next share one pass over memory.

    after : as for `v_cycle`, in the last cycle
    """
    level, coarse = levels[:2]
    steps = smoothing()
    rhs, offsets = coarse.rhs if cycles else None, None if level.weight_x is None else level.z
    sweep(level, steps, offsets, level.spare, coarse=coarse.z, nested=True, coarse_rhs=rhs)
    level.swap()
    if not cycles:
        return 0.0
    corrections = []
    for _ in range(cycles - 1):
        v_cycle(levels[1:], solve)
        corrections.append(root_mean_square(coarse.z))
        sweep(level, smoothing(2), level.z, level.spare, coarse=coarse.z, coarse_rhs=coarse.rhs)
        level.swap()
    v_cycle(levels[1:], solve)
    corrections.append(root_mean_square(coarse.z))
    sweep(level, smoothing(after), level.z, level.spare, coarse=coarse.z)
    level.swap()
    return geometric_tail(corrections)


@cache
def smoothing(times: int = 1) -> Float32Array:
    """Relaxation factors, float32 array: for one smoothing, or (2) after a correction and before the next."""
    return np.tile(chebyshev_steps(SWEEPS), times)
