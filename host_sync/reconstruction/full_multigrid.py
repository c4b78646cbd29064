"""Full multigrid: from the coarsest level to the finest, then V-cycles until what is left is small enough.

Edges are made coarser level by level (`condense`), the coarsest level is solved, and each level starts from the one
below it by adding the shapes of its cells. Coarse levels are then improved by V-cycles: smooth, restrict the residual,
solve for the correction one level down, interpolate it, smooth. The finest level is smoothed; it takes V-cycles only
where the error that is left asks for them, and conjugate gradients around them where they gain too little.

What is left. Shapes and coarse slopes are exact for slopes that belong to a surface, so that smoothing on the finest
level repairs what noise alone has left, and how much it changes is a measure of that noise. Without a tolerance cycles
end when the estimated error is less than half of it. The correction that a cycle brings is a measure of the error that
it removed; with a contraction ρ per cycle the error left is about ρ times that.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.reconstruction.coarsest import pseudo_inverse, solve_coarsest, write_divergence
from host_sync.reconstruction.condense import condense, condense_pixels
from host_sync.reconstruction.conjugate_gradients import conjugate_gradients
from host_sync.reconstruction.grid_level import GridLevel, PixelField
from host_sync.reconstruction.islands import Islands
from host_sync.reconstruction.level_rows import written_level
from host_sync.reconstruction.rectangle import level_cells
from host_sync.reconstruction.sweep import root_mean_square, sweep
from host_sync.reconstruction.v_cycle import nested_cycles, smoothing, v_cycle

EXPECTED_CONTRACTION: Final = 0.5
LEAST_CONTRACTION: Final = 0.1
SLOW_CONTRACTION: Final = 0.6

START_SHARE: Final = 0.4
"""Error left after the first smoothing without weights, as a share of what it changed (0.27 was measured)."""

NOISE_SHARE: Final = 0.5
"""Tolerance, as a share of what the first smoothing changed, where none is given."""

APART: Final = 0.5
"""Share of the bound of paths apart in coarse weights (see `conductance`)."""

COARSE_CYCLES: Final = 1, 0
WEIGHTED_CYCLES: Final = 2, 1
"""V-cycles on coarse levels in general and on the one below the pixels, without and with weights."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What full multigrid found.

    z : float32 array of shape (H, W), heights
    residuals : root mean square of the residual in each V-cycle on the finest level, heights times weight
    error : estimated algebraic error of the heights, root mean square; NaN where slopes were not finite
    tolerance : what it was asked to be
    levelled : whether a full rectangle has mean zero already
    """

    z: Float32Array
    residuals: tuple[float, ...]
    error: float
    tolerance: float
    levelled: bool = False


def full_multigrid(
    field: PixelField,
    levels: list[GridLevel],
    heights: tuple[Float32Array, Float32Array],
    islands: Islands | None,
    tolerance: float | None,
    max_cycles: int,
) -> Solution:
    """Least-squares heights; they stand in one of the two arrays `heights`, or in a new one.

    levels : those below the pixels, the finest first
    tolerance : estimated error of heights at which V-cycles end; None for a share of what noise leaves
    """
    if not levels:
        return _solve_at_once(field, tolerance)
    inverse = _coarse_solution(field, levels, APART)
    solution = _finest_cycles(field, levels, inverse, heights, tolerance, max_cycles)
    cycles = max_cycles - len(solution.residuals)
    if not solution.error > solution.tolerance or cycles <= 0:
        return solution
    return _conjugate_gradients(field, levels, islands, solution, cycles)


def _conjugate_gradients(
    field: PixelField, levels: list[GridLevel], islands: Islands | None, so_far: Solution, max_cycles: int
) -> Solution:
    """The solution by conjugate gradients around V-cycles on levels that let no cycle diverge."""
    finest = written_level(field)
    inverse = _coarse_solution(field, levels, 0.0)
    sweep(field, smoothing(), None, finest.z, coarse=levels[0].z, nested=True)
    rhs = finest.rhs.astype(np.float64)
    if islands is None:
        rhs -= rhs.mean()
    else:
        islands.balance(rhs)
    start = finest.z.astype(np.float64)
    every = [finest, *levels]
    found = conjugate_gradients(finest, rhs, start, lambda: v_cycle(every, inverse), so_far.tolerance, max_cycles)
    return Solution(found.z, so_far.residuals + found.residuals, found.error, so_far.tolerance)


def _solve_at_once(field: PixelField, tolerance: float | None) -> Solution:
    """The solution of a field so small that it is its own coarsest level."""
    level = written_level(field)
    solve_coarsest(level, pseudo_inverse(level))
    error = 0.0 if np.isfinite(level.z).all() else float("nan")
    return Solution(level.z, (), error, field.least_tolerance if tolerance is None else tolerance)


def _coarse_solution(field: PixelField, levels: list[GridLevel], apart: float) -> Float64Array:
    """Solve the level below the pixels, from the coarsest upwards; returns the coarsest level's pseudo-inverse."""
    condense_pixels(field, levels[0], apart)
    for level, coarse in pairwise(levels):
        condense(level, coarse, apart)
    write_divergence(levels[-1])
    inverse = pseudo_inverse(levels[-1])
    solve_coarsest(levels[-1], inverse)
    many, few = COARSE_CYCLES if field.weight is None else WEIGHTED_CYCLES
    for depth in range(len(levels) - 2, -1, -1):
        nested_cycles(levels[depth:], inverse, many if depth else few)
    return inverse


def _finest_cycles(
    field: PixelField,
    levels: list[GridLevel],
    inverse: Float64Array,
    heights: tuple[Float32Array, Float32Array],
    tolerance: float | None,
    max_cycles: int,
) -> Solution:
    """Start the finest level and improve it until it is good enough or a cycle gains too little.

    A cycle's last sweeps and the next one's first are one pass over memory.
    """
    weighted = field.weight is not None
    coarse, steps, both = levels[0], smoothing(), smoothing(2)
    before, after = heights
    rhs = coarse.rhs if weighted else None
    if not weighted:
        level_cells(coarse.z, (field.p.shape[0], field.p.shape[1]))
    first = sweep(field, steps, None, before, coarse=coarse.z, nested=True, coarse_rhs=rhs, measured=True)
    tolerance = max(NOISE_SHARE * first.change, field.least_tolerance) if tolerance is None else tolerance
    error = START_SHARE * first.change
    if not np.isfinite(error) or max_cycles == 0 or (not weighted and error <= tolerance):
        return Solution(before, (), error, tolerance, levelled=True)
    if not weighted:
        first = sweep(field, smoothing(0), before, after, coarse_rhs=coarse.rhs, measured=True)
        before, after = after, before
    residuals = [first.residual]
    corrections: list[float] = []
    while True:
        v_cycle(levels, inverse)
        corrections.append(root_mean_square(coarse.z))
        error = _remaining_error(corrections)
        if error <= tolerance or len(corrections) >= max_cycles or _stalls(corrections):
            sweep(field, steps, before, after, coarse=coarse.z)
            return Solution(after, tuple(residuals), error, tolerance)
        figures = sweep(field, both, before, after, coarse=coarse.z, coarse_rhs=coarse.rhs, measured=True)
        residuals.append(figures.residual)
        before, after = after, before


def _stalls(corrections: list[float]) -> bool:
    """Whether the last cycle fell short of the contraction that V-cycles are worth repeating for."""
    return len(corrections) > 2 and corrections[-1] > SLOW_CONTRACTION * corrections[-2]


def _remaining_error(corrections: list[float]) -> float:
    """Estimated error after the last of these corrections."""
    last = corrections[-1]
    if len(corrections) == 1 or corrections[-2] == 0.0:
        return EXPECTED_CONTRACTION * last
    contraction = max(last / corrections[-2], LEAST_CONTRACTION)
    return last * contraction / (1.0 - contraction) if contraction < 1.0 else float("inf")
