"""Full multigrid: solve the coarsest level, then go up level by level, then V-cycles until the error is small enough.

Edges are coarsened level by level (`coarsen`) and the coarsest level is solved directly. Each level starts from the one
below it plus prolongation offsets. Coarse levels are then improved by V-cycles: smooth, restrict the residual, solve
for the correction one level down, interpolate it, smooth. The finest level is smoothed; it takes V-cycles only where
the estimated error requires them, and conjugate gradients around V-cycles where these converge too
slowly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.fft import dctn, idctn

from device.surface import Float32Array, Float64Array, eigenvalues
from host_sync.integration.coarsening import coarsen, coarsen_pixels
from host_sync.integration.components import Components, center_cells
from host_sync.integration.conjugate_gradients import conjugate_gradients
from host_sync.integration.levels import FineLevel, GridLevel, edge_weights
from host_sync.integration.matrix_free_rows import build_level
from host_sync.integration.smoother import chebyshev_steps
from host_sync.integration.sweep import root_mean_square, sweep
from host_sync.integration.transfer import add_correction, add_weighted_correction
from host_sync.kernels.jit import get_num_threads
from host_sync.kernels.parallel_rows import BackgroundCall

# Direct solution on the coarsest level: by cosine transform where every edge weighs 1, else by the pseudo-inverse.
#
# The coarse levels of a full rectangle of even size are full rectangles too. The discrete cosine transform solves these
# exactly, in less time than calling the kernels of many small levels takes. (Cells at an odd end are smaller: from
# there on levels have weights.)

NULL_TOLERANCE: Final = 1e-10
"""Eigenvalue of D^-½ A D^-½ below which a mode counts as the free mean of a component."""

DirectSolver = Callable[[GridLevel], None]
"""Writes a level's heights from its right-hand side; the cosine solver makes their mean zero."""


def direct_solver(level: GridLevel) -> DirectSolver:
    """Return the solver for this level, for any right-hand side."""
    if level.weight_x is None:
        return _solve_by_cosines
    return partial(_solve_by_inverse, pseudo_inverse(level))


def pseudo_inverse(level: GridLevel) -> Float64Array:
    """Return the pseudo-inverse of a small level's Laplacian, float64 array (H·W, H·W); free means are zero."""
    weight_x, weight_y = (weights.astype(np.float64) for weights in edge_weights(level))
    rows, columns = level.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    laplacian = np.zeros((index.size, index.size))
    laplacian[index[:, 1:], index[:, :-1]] = -weight_x[:, 1:-1]
    laplacian[index[1:], index[:-1]] = -weight_y[1:-1]
    laplacian += laplacian.T
    diagonal = -laplacian.sum(axis=1)
    laplacian[np.diag_indices_from(laplacian)] = diagonal
    scale = np.divide(1.0, np.sqrt(diagonal), out=np.zeros_like(diagonal), where=diagonal > 0.0)
    inverse = np.linalg.pinv(scale[:, None] * laplacian * scale, rcond=NULL_TOLERANCE, hermitian=True)
    return np.asarray(scale[:, None] * inverse * scale, np.float64)


def write_divergence(level: GridLevel) -> None:
    """Write the level's right-hand side, the divergence of its edges' weighted slopes."""
    slope_x, slope_y = level.slope_x, level.slope_y
    if level.weight_x is not None and level.weight_y is not None:
        slope_x, slope_y = level.weight_x * slope_x, level.weight_y * slope_y
    np.subtract(slope_x[:, :-1], slope_x[:, 1:], out=level.rhs)
    level.rhs += slope_y[:-1]
    level.rhs -= slope_y[1:]


def _solve_by_inverse(inverse: Float64Array, level: GridLevel) -> None:
    z: Float32Array = (inverse @ level.rhs.ravel().astype(np.float64)).astype(np.float32)
    level.z[:] = z.reshape(level.shape)


def _solve_by_cosines(level: GridLevel) -> None:
    """Solve in double precision: single precision leaves errors in the longest waves, which no finer level removes."""
    threads = get_num_threads()
    spectrum = dctn(level.rhs.astype(np.float64), type=2, norm="ortho", overwrite_x=True, workers=threads)
    spectrum *= _inverse_eigenvalues(level.shape)
    level.z[:] = idctn(spectrum, type=2, norm="ortho", overwrite_x=True, workers=threads)


@lru_cache(maxsize=4)
def _inverse_eigenvalues(shape: tuple[int, int]) -> Float64Array:
    """Return the inverse eigenvalues of the Laplacian, float64 array of this shape; 0 for the mean."""
    return np.asarray(1.0 / eigenvalues(shape))


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
    """Return the relaxation factors of `times` smoothings, 2 between one correction and the next, float32 array."""
    return np.tile(chebyshev_steps(SWEEPS), times)


COARSE_WEIGHT_DAMPING: Final = 0.5
"""Weight of the series bound in coarse edge weights (see `conductance`)."""

COARSE_CYCLES: Final = 0, 0, 3
WEIGHTED_CYCLES: Final = 1, 2, 3
"""V-cycles per coarse level, finest first (the last value repeats): unweighted, weighted.

Where levels of odd size do not end in a transform, inconsistent slopes of long wavelength need three cycles: after one,
the error was several times the estimate, which sees only the pixels.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of full multigrid.

    z : float32 array of shape (H, W), heights
    residuals : root mean square residual in each V-cycle on the finest level, heights times weight
    error : estimated algebraic error of the heights, root mean square; NaN where slopes were not finite
    tolerance : the error at which cycles ended or should have ended
    centered : whether a full rectangle has mean zero already
    moments : Σ w z of each run of the components (see `Components`), where known
    """

    z: Float32Array
    residuals: tuple[float, ...]
    error: float
    tolerance: float
    centered: bool = False
    moments: Float64Array | None = None


def full_multigrid(
    field: FineLevel,
    levels: list[GridLevel],
    heights: tuple[Float32Array, Float32Array],
    components: BackgroundCall[Components] | None,
    tolerance: float | None,
    max_cycles: int,
) -> Solution:
    """Return the least-squares heights, in one of the two arrays `heights` or in a new one.

    levels : coarse levels, finest first
    components : those of a weighted field; started when coarse levels leave a thread idle
    tolerance : estimated error of heights at which V-cycles end; None for a fraction of what noise does
    """
    if not levels:
        return _solve_directly(field, tolerance)
    coarse = _coarse_solution(field, levels, COARSE_WEIGHT_DAMPING, components)
    solution = _finest_cycles(field, levels, *coarse, heights, components, tolerance, max_cycles)
    cycles = max_cycles - len(solution.residuals)
    if not solution.error > solution.tolerance or cycles <= 0:
        return solution
    return _conjugate_gradients(field, levels, components, solution, cycles)


def _conjugate_gradients(
    field: FineLevel,
    levels: list[GridLevel],
    components: BackgroundCall[Components] | None,
    solution: Solution,
    max_cycles: int,
) -> Solution:
    """Return the solution by conjugate gradients with V-cycles on undamped levels; it cannot diverge."""
    finest = build_level(field)
    solve, _ = _coarse_solution(field, levels, 0.0)
    sweep(field, smoothing(), None, finest.z, coarse=levels[0].z, nested=True)
    rhs = finest.rhs.astype(np.float64)
    if components is None:
        rhs -= rhs.mean()
    else:
        components.result().project_rhs(rhs)
    start = finest.z.astype(np.float64)
    all_levels = [finest, *levels]
    found = conjugate_gradients(finest, rhs, start, lambda: v_cycle(all_levels, solve), solution.tolerance, max_cycles)
    return Solution(found.z, solution.residuals + found.residuals, found.error, solution.tolerance)


def _solve_directly(field: FineLevel, tolerance: float | None) -> Solution:
    """Return the solution of a field so small that it is its own coarsest level."""
    level = build_level(field)
    direct_solver(level)(level)
    error = 0.0 if np.isfinite(level.z).all() else float("nan")
    return Solution(level.z, (), error, field.min_tolerance if tolerance is None else tolerance)


def _coarse_solution(
    field: FineLevel,
    levels: list[GridLevel],
    coarse_weight_damping: float,
    components: BackgroundCall[Components] | None = None,
) -> tuple[DirectSolver, float]:
    """Solve the level below the pixels, coarsest level first; start labelling `components` meanwhile.

    Returns the direct solver of the coarsest level, and the estimated error of the finest level that had several
    cycles; 0 where none had.
    """
    coarsen_pixels(field, levels[0], coarse_weight_damping)
    for level, coarse in pairwise(levels):
        coarsen(level, coarse, coarse_weight_damping)
    if components is not None:
        components.start()
    write_divergence(levels[-1])
    solve = direct_solver(levels[-1])
    solve(levels[-1])
    cycles = COARSE_CYCLES if field.weight is None else WEIGHTED_CYCLES
    error = 0.0
    for depth in range(len(levels) - 2, -1, -1):
        times, after = cycles[min(depth, len(cycles) - 1)], 1 if depth else 0
        error = nested_cycles(levels[depth:], solve, times, after) or error
    return solve, error


def _finest_cycles(
    field: FineLevel,
    levels: list[GridLevel],
    solve: DirectSolver,
    coarse_error: float,
    heights: tuple[Float32Array, Float32Array],
    components: BackgroundCall[Components] | None,
    tolerance: float | None,
    max_cycles: int,
) -> Solution:
    """Start the finest level and improve it until it is accurate enough or a cycle gains too little.

    The last sweeps of a cycle and the first of the next share one pass over memory; those after the last cycle are
    skipped.
    """
    weighted = field.weight is not None
    coarse, steps, both = levels[0], smoothing(), smoothing(2)
    before, after = heights
    rhs = coarse.rhs if weighted else None
    if not weighted and levels[-1].weight_x is not None:
        center_cells(coarse.z, (field.p.shape[0], field.p.shape[1]))
    first = sweep(field, steps, None, before, coarse=coarse.z, nested=True, coarse_rhs=rhs, measured=True)
    tolerance = max(NOISE_FRACTION * first.change, field.min_tolerance) if tolerance is None else tolerance
    error = START_FRACTION * first.change + coarse_error
    if not np.isfinite(first.change):
        return Solution(before, (), float("nan"), tolerance)
    if max_cycles == 0 or (not weighted and error <= tolerance):
        return Solution(before, (), error, tolerance, centered=not weighted)
    if not weighted:
        first = sweep(field, smoothing(0), before, after, coarse_rhs=coarse.rhs, measured=True)
        before, after = after, before
    residuals = [first.residual]
    corrections: list[float] = []
    while True:
        v_cycle(levels, solve, after=0)
        corrections.append(root_mean_square(coarse.z))
        error = remaining_error(corrections, coarse_error)
        if error <= tolerance or len(corrections) >= max_cycles or stalls(corrections):
            if field.weight is None or components is None:
                add_correction(before, coarse.z)
                return Solution(before, tuple(residuals), error, tolerance)
            moments = add_weighted_correction(before, coarse.z, field.weight, components.result())
            return Solution(before, tuple(residuals), error, tolerance, moments=moments)
        figures = sweep(field, both, before, after, coarse=coarse.z, coarse_rhs=coarse.rhs, measured=True)
        residuals.append(figures.residual)
        before, after = after, before


# Estimates the algebraic error that full multigrid leaves, from its own passes.
#
# Prolongation offsets and coarse slopes are exact for slopes that belong to a surface. Smoothing on the finest level
# therefore repairs only what noise has left, and the change it makes measures that noise: without a tolerance, cycles
# end when the estimated error is a fraction of it. The correction by a cycle measures the error that it removed. One
# correction does not show how fast errors fall, which narrow bridges between holes slow down; the cycles of the coarse
# levels show that, so their remaining error is added. From the second cycle on, the finest level's own corrections are
# used.
#
# The fractions were found for white noise. Errors that are correlated from row to row, such as stripes that 2:1
# coarsening cannot separate, may be underestimated many times. Rounding in single precision is not included.

SLOW_CONTRACTION: Final = 0.6
"""Ratio of successive corrections above which V-cycles stop."""

START_FRACTION: Final = 0.4
"""Error after the first smoothing, as a fraction of its change (0.27 was measured without weights)."""

CYCLE_FRACTION: Final = 0.6
"""Error after the first cycle, as a fraction of its correction; the error of the coarse levels is added."""

SLOWDOWN: Final = 0.25
"""Fraction by which the ratio of successive corrections is moved towards 1 (see `geometric_tail`)."""

NOISE_FRACTION: Final = 0.55
"""Default tolerance, as a fraction of the change by the first smoothing: adds less than 1 % to the effect of noise on
heights."""

MAX_RATIO: Final = 0.9
"""Largest ratio of successive corrections used in the estimate: at the level of rounding, corrections stop falling."""


def stalls(corrections: list[float]) -> bool:
    """Return True where the last cycle contracted too little for more V-cycles to be worthwhile."""
    return len(corrections) > 2 and corrections[-1] > SLOW_CONTRACTION * corrections[-2]


def remaining_error(corrections: list[float], coarse_error: float) -> float:
    """Return the estimated error after the last of these corrections; `coarse_error` is what the coarse levels left."""
    if len(corrections) == 1:
        return CYCLE_FRACTION * corrections[0] + coarse_error
    return geometric_tail(corrections, SLOWDOWN)


def geometric_tail(corrections: list[float], slowed: float = 0.0) -> float:
    """Return the sum of the remaining corrections, extrapolated as a geometric series; 0 after a single cycle.

    slowed : fraction by which the ratio of successive corrections is moved towards 1
    """
    if len(corrections) < 2 or corrections[-2] == 0.0:
        return 0.0
    ratio = min(corrections[-1] / corrections[-2], MAX_RATIO)
    ratio += slowed * (1.0 - ratio)
    return corrections[-1] * ratio / (1.0 - ratio)
