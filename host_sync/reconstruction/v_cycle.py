"""The V-cycle: smooth, restrict the residual, correct from the next level, interpolate, smooth."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from device.surface import Float32Array
from host_sync.reconstruction.coarsest import DirectSolver
from host_sync.reconstruction.grid_level import GridLevel
from host_sync.reconstruction.smoother import chebyshev_steps
from host_sync.reconstruction.stated_error import still_to_come
from host_sync.reconstruction.sweep import root_mean_square, sweep

SWEEPS: Final = 2
"""Sweeps before and after the correction."""


def v_cycle(levels: list[GridLevel], solve: DirectSolver, after: int = 1) -> None:
    """Leave in the first level's `z` the heights that one cycle from nought finds for its right-hand side.

    The right-hand sides of the levels below are overwritten.

    solve : `direct_solver` of the last level
    after : how often the first level is smoothed after its correction; never where only pixels are finer, for whom
        what is uneven in it is too small to matter
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
    """Solve the first level from the heights of the next one: add shapes, smooth, then improve by V-cycles.

    Returns the error that is left, as far as several cycles show it. A cycle's last sweeps and the next one's first are
    one pass over memory.

    after : as for `v_cycle`, in the last cycle
    """
    level, coarse = levels[:2]
    steps = smoothing()
    rhs, shapes = coarse.rhs if cycles else None, None if level.across is None else level.z
    sweep(level, steps, shapes, level.spare, coarse=coarse.z, nested=True, coarse_rhs=rhs)
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
    return still_to_come(corrections)


@cache
def smoothing(times: int = 1) -> Float32Array:
    """Relaxation factors, float32 array: before or after a correction, or (2) after one and before the next."""
    return np.tile(chebyshev_steps(SWEEPS), times)
