"""Height map from slopes by full multigrid: min Σ w_e (f_b - f_a - g_e)² over the edges between valid pixels.

Paper, eqs. 9 and 10, with a weight per edge, holes and free (Neumann) borders. A coarse level's solution starts the
next finer one (full multigrid); each level is then improved by V-cycles: smooth, restrict the residual, solve for the
correction one level down, interpolate it, smooth.

The correction that a cycle brings is a measure of the error that it removed. With a contraction ρ per cycle the error
left is about ρ times that; ρ is measured as soon as there are two corrections.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array, GradientField, HeightMap
from host_sync.reconstruction.coarsest import pseudo_inverse, solve_coarsest
from host_sync.reconstruction.conjugate_gradients import conjugate_gradients
from host_sync.reconstruction.edge_slopes import EdgeRule, edge_coefficients, edge_system
from host_sync.reconstruction.grid_level import GridLevel, coarser_levels, finest_level
from host_sync.reconstruction.islands import Islands, find_islands, level_islands
from host_sync.reconstruction.survey import survey
from host_sync.reconstruction.sweep import sweep
from host_sync.reconstruction.transfer import restrict_field
from host_sync.reconstruction.v_cycle import smoothing, v_cycle

EXPECTED_CONTRACTION: Final = 0.5
LEAST_CONTRACTION: Final = 0.1
SLOW_CONTRACTION: Final = 0.6


@dataclass(frozen=True, slots=True)
class IntegrationReport:
    """What the solver did.

    cycles : V-cycles on the finest level, the last of full multigrid included
    residuals : root mean square of the residual in each of them, after its first smoothing, pixels times weight
    islands : connected parts, each with a level of its own
    converged : whether the estimated algebraic error reached the tolerance
    error_px : estimated algebraic error, root mean square, pixels
    """

    cycles: int
    residuals: tuple[float, ...]
    islands: int
    converged: bool
    error_px: float


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Heights in pixels, residual of each cycle, estimated error in pixels."""

    z: Float32Array
    residuals: tuple[float, ...]
    error_px: float


def integrate(
    gradients: GradientField,
    pitch_um: float,
    *,
    edges: EdgeRule = "fourth-order",
    tolerance_px: float = 1e-3,
    max_cycles: int = 200,
) -> tuple[HeightMap, IntegrationReport]:
    """Height map of least squares, and how it was reached.

    A pixel that is not valid or weighs nothing is a hole, NaN in the result. Each island (part that is connected
    through neighbouring pixels) has a weighted mean of zero.

    edges : how slopes become height differences between neighbours (see `edge_slopes`)
    tolerance_px : estimated algebraic error at which cycles end, pixels
    max_cycles : V-cycles on the finest level after which it ends in any case

    Raises
    ------
    IntegrationError
        Shapes differ, a valid pixel has no finite slope or weight, or no pixel is valid.
    """
    found = survey(gradients)
    levels = _levels(gradients, edges, found.weighted)
    islands = find_islands(gradients, found.holes)
    solution = _full_multigrid(levels, islands, tolerance_px, max_cycles)
    level_islands(solution.z, gradients, islands, pitch_um)
    residuals, error_px = solution.residuals, solution.error_px
    report = IntegrationReport(len(residuals), residuals, islands.count, error_px <= tolerance_px, error_px)
    return HeightMap(solution.z, pitch_um), report


def _levels(gradients: GradientField, edges: EdgeRule, weighted: bool) -> list[GridLevel]:
    """All levels with their weights and right-hand sides."""
    p, q = (np.ascontiguousarray(slope, np.float32) for slope in (gradients.p, gradients.q))
    weight = np.ascontiguousarray(gradients.weight, np.float32) if weighted else None
    finest = finest_level(gradients.valid.shape, weighted)
    valid = np.ascontiguousarray(gradients.valid)
    edge_system(p, q, weight, valid, edge_coefficients(edges), finest.across, finest.down, finest.rhs, finest.bands)
    levels = coarser_levels(finest)
    for fine, coarse in pairwise(levels):
        restrict_field(fine.rhs, coarse.rhs)
    return levels


def _full_multigrid(levels: list[GridLevel], islands: Islands, tolerance_px: float, max_cycles: int) -> _Solution:
    """Solve from the coarsest level to the finest, there until the estimated error is within the tolerance."""
    inverse = pseudo_inverse(levels[-1])
    solve_coarsest(levels[-1], inverse)
    if len(levels) == 1:
        return _Solution(levels[0].z, (), 0.0)
    for depth in range(len(levels) - 2, 0, -1):
        level, coarse = levels[depth], levels[depth + 1]
        sweep(level, smoothing(level), None, level.spare, coarse=coarse.z, coarse_rhs=coarse.rhs)
        v_cycle(levels[depth + 1 :], inverse)
        sweep(level, smoothing(level), level.spare, level.z, coarse=coarse.z)
    solution = _v_cycles(levels, inverse, tolerance_px, max_cycles)
    cycles = max_cycles - len(solution.residuals)
    if solution.error_px <= tolerance_px or cycles <= 0:
        return solution
    rhs = levels[0].rhs.astype(np.float64)
    islands.balance(rhs)
    start = solution.z.astype(np.float64)
    better = conjugate_gradients(levels[0], rhs, start, lambda: v_cycle(levels, inverse), tolerance_px, cycles)
    return _Solution(better.z, solution.residuals + better.residuals, better.error_px)


def _v_cycles(levels: list[GridLevel], inverse: Float64Array, tolerance_px: float, max_cycles: int) -> _Solution:
    """Improve the finest level until it is good enough or a cycle gains too little.

    A cycle's last sweeps and the next one's first are one pass over memory.
    """
    level, coarse = levels[:2]
    steps = smoothing(level)
    before, after = level.spare, level.z
    residuals = [sweep(level, steps, None, before, coarse=coarse.z, coarse_rhs=coarse.rhs)]
    corrections: list[float] = []
    while True:
        corrections.append(v_cycle(levels[1:], inverse))
        error_px = _remaining_error(corrections)
        if error_px <= tolerance_px or len(corrections) >= max_cycles or _stalls(corrections):
            sweep(level, steps, before, after, coarse=coarse.z)
            return _Solution(after, tuple(residuals), error_px)
        both = np.concatenate([steps, steps])
        residuals.append(sweep(level, both, before, after, coarse=coarse.z, coarse_rhs=coarse.rhs))
        before, after = after, before


def _stalls(corrections: list[float]) -> bool:
    """Whether the last cycle fell short of the contraction that V-cycles are worth repeating for."""
    return len(corrections) > 2 and corrections[-1] > SLOW_CONTRACTION * corrections[-2]


def _remaining_error(corrections: list[float]) -> float:
    """Estimated error, px, after the last of these corrections."""
    last = corrections[-1]
    if len(corrections) == 1 or corrections[-2] == 0.0:
        return EXPECTED_CONTRACTION * last
    contraction = max(last / corrections[-2], LEAST_CONTRACTION)
    return last * contraction / (1.0 - contraction) if contraction < 1.0 else float("inf")
