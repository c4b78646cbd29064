"""Full multigrid: from the coarsest level to the finest, then V-cycles until what is left is small enough.

Edges are made coarser level by level (`condense`), the coarsest level is solved, and each level starts from the one
below it by adding the shapes of its cells. Coarse levels are then improved by V-cycles: smooth, restrict the residual,
solve for the correction one level down, interpolate it, smooth. The finest level is smoothed; it takes V-cycles only
where the error that is left asks for them (`stated_error`), and conjugate gradients around them where they gain too
little.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.reconstruction.coarsest import DirectSolver, direct_solver, write_divergence
from host_sync.reconstruction.condense import condense, condense_pixels
from host_sync.reconstruction.conjugate_gradients import conjugate_gradients
from host_sync.reconstruction.correction import add_correction, add_weighted_correction
from host_sync.reconstruction.grid_level import GridLevel, PixelField
from host_sync.reconstruction.islands import Islands
from host_sync.reconstruction.level_rows import written_level
from host_sync.reconstruction.rectangle import level_cells
from host_sync.reconstruction.row_bands import Beside
from host_sync.reconstruction.stated_error import NOISE_SHARE, START_SHARE, error_left, stalls
from host_sync.reconstruction.sweep import root_mean_square, sweep
from host_sync.reconstruction.v_cycle import nested_cycles, smoothing, v_cycle

APART: Final = 0.5
"""Share of the bound of paths apart in coarse weights (see `conductance`)."""

COARSE_CYCLES: Final = 0, 0, 3
WEIGHTED_CYCLES: Final = 1, 2, 3
"""V-cycles on the level below the pixels and on those below it, the last for all that follow; without, with weights.

Where levels of odd size end in no transform, what slopes contradict in long waves takes three: one left it several
times as large as the estimate, which looks at the pixels alone."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What full multigrid found.

    z : float32 array of shape (H, W), heights
    residuals : root mean square of the residual in each V-cycle on the finest level, heights times weight
    error : estimated algebraic error of the heights, root mean square; NaN where slopes were not finite
    tolerance : what it was asked to be
    levelled : whether a full rectangle has mean zero already
    moments : those of the islands' runs (see `Islands`), where they are known
    """

    z: Float32Array
    residuals: tuple[float, ...]
    error: float
    tolerance: float
    levelled: bool = False
    moments: Float64Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CoarseSolution:
    """What is known when the level below the pixels is solved.

    solve : direct solver of the coarsest level
    error : estimated error of the finest level that had several cycles; nought where none had
    """

    solve: DirectSolver
    error: float


def full_multigrid(
    field: PixelField,
    levels: list[GridLevel],
    heights: tuple[Float32Array, Float32Array],
    islands: Beside[Islands] | None,
    tolerance: float | None,
    max_cycles: int,
) -> Solution:
    """Least-squares heights; they stand in one of the two arrays `heights`, or in a new one.

    levels : those below the pixels, the finest first
    islands : those of a field with weights; begun to be found when coarse levels leave a thread idle
    tolerance : estimated error of heights at which V-cycles end; None for a share of what noise leaves
    """
    if not levels:
        return _solve_at_once(field, tolerance)
    coarse = _coarse_solution(field, levels, APART, islands)
    solution = _finest_cycles(field, levels, coarse, heights, islands, tolerance, max_cycles)
    cycles = max_cycles - len(solution.residuals)
    if not solution.error > solution.tolerance or cycles <= 0:
        return solution
    return _conjugate_gradients(field, levels, islands, solution, cycles)


def _conjugate_gradients(
    field: PixelField,
    levels: list[GridLevel],
    islands: Beside[Islands] | None,
    so_far: Solution,
    max_cycles: int,
) -> Solution:
    """The solution by conjugate gradients around V-cycles on levels that let no cycle diverge."""
    finest = written_level(field)
    solve = _coarse_solution(field, levels, 0.0).solve
    sweep(field, smoothing(), None, finest.z, coarse=levels[0].z, nested=True)
    rhs = finest.rhs.astype(np.float64)
    if islands is None:
        rhs -= rhs.mean()
    else:
        islands.result().balance(rhs)
    start = finest.z.astype(np.float64)
    every = [finest, *levels]
    found = conjugate_gradients(finest, rhs, start, lambda: v_cycle(every, solve), so_far.tolerance, max_cycles)
    return Solution(found.z, so_far.residuals + found.residuals, found.error, so_far.tolerance)


def _solve_at_once(field: PixelField, tolerance: float | None) -> Solution:
    """The solution of a field so small that it is its own coarsest level."""
    level = written_level(field)
    direct_solver(level)(level)
    error = 0.0 if np.isfinite(level.z).all() else float("nan")
    return Solution(level.z, (), error, field.least_tolerance if tolerance is None else tolerance)


def _coarse_solution(
    field: PixelField, levels: list[GridLevel], apart: float, meanwhile: Beside[Islands] | None = None
) -> CoarseSolution:
    """Solve the level below the pixels, from the coarsest upwards, and begin with what is to be done meanwhile."""
    condense_pixels(field, levels[0], apart)
    for level, coarse in pairwise(levels):
        condense(level, coarse, apart)
    if meanwhile is not None:
        meanwhile.begin()
    write_divergence(levels[-1])
    solve = direct_solver(levels[-1])
    solve(levels[-1])
    cycles = COARSE_CYCLES if field.weight is None else WEIGHTED_CYCLES
    error = 0.0
    for depth in range(len(levels) - 2, -1, -1):
        times, after = cycles[min(depth, len(cycles) - 1)], 1 if depth else 0
        error = nested_cycles(levels[depth:], solve, times, after) or error
    return CoarseSolution(solve, error)


def _finest_cycles(
    field: PixelField,
    levels: list[GridLevel],
    solved: CoarseSolution,
    heights: tuple[Float32Array, Float32Array],
    islands: Beside[Islands] | None,
    tolerance: float | None,
    max_cycles: int,
) -> Solution:
    """Start the finest level and improve it until it is good enough or a cycle gains too little.

    A cycle's last sweeps and the next one's first are one pass over memory; the last cycle's are left out.
    """
    weighted = field.weight is not None
    coarse, steps, both = levels[0], smoothing(), smoothing(2)
    before, after = heights
    rhs = coarse.rhs if weighted else None
    if not weighted and levels[-1].across is not None:
        level_cells(coarse.z, (field.p.shape[0], field.p.shape[1]))
    first = sweep(field, steps, None, before, coarse=coarse.z, nested=True, coarse_rhs=rhs, measured=True)
    tolerance = max(NOISE_SHARE * first.change, field.least_tolerance) if tolerance is None else tolerance
    error = START_SHARE * first.change + solved.error
    if not np.isfinite(first.change):
        return Solution(before, (), float("nan"), tolerance)
    if max_cycles == 0 or (not weighted and error <= tolerance):
        return Solution(before, (), error, tolerance, levelled=not weighted)
    if not weighted:
        first = sweep(field, smoothing(0), before, after, coarse_rhs=coarse.rhs, measured=True)
        before, after = after, before
    residuals = [first.residual]
    corrections: list[float] = []
    while True:
        v_cycle(levels, solved.solve, after=0)
        corrections.append(root_mean_square(coarse.z))
        error = error_left(corrections, solved.error)
        if error <= tolerance or len(corrections) >= max_cycles or stalls(corrections):
            if field.weight is None or islands is None:
                add_correction(before, coarse.z)
                return Solution(before, tuple(residuals), error, tolerance)
            moments = add_weighted_correction(before, coarse.z, field.weight, islands.result())
            return Solution(before, tuple(residuals), error, tolerance, moments=moments)
        figures = sweep(field, both, before, after, coarse=coarse.z, coarse_rhs=coarse.rhs, measured=True)
        residuals.append(figures.residual)
        before, after = after, before
