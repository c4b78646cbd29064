"""Estimates the algebraic error that full multigrid leaves, from its own passes.

Prolongation offsets and coarse slopes are exact for slopes that belong to a surface. Smoothing on the finest level
therefore repairs only what noise has left, and the change it makes measures that noise: without a tolerance, cycles end
when the estimated error is a fraction of it. The correction by a cycle measures the error that it removed. One
correction does not show how fast errors fall, which narrow bridges between holes slow down; the cycles of the coarse
levels show that, so their remaining error is added. From the second cycle on, the finest level's own corrections are
used.

The fractions were found for white noise. Errors that are correlated from row to row, such as stripes that 2:1
coarsening cannot separate, may be underestimated many times. Rounding in single precision is not included.
"""

from __future__ import annotations

from typing import Final

SLOW_CONTRACTION: Final = 0.6
"""Ratio of successive corrections above which V-cycles stop."""

START_FRACTION: Final = 0.4
"""Error after the first smoothing, as a fraction of its change (0.27 was measured without weights)."""

CYCLE_FRACTION: Final = 0.6
"""Error after the first cycle, as a fraction of its correction; the error of the coarse levels is added."""

SLOWDOWN: Final = 0.25
"""How much more slowly the remaining error falls than the corrections did (see `geometric_tail`)."""

NOISE_FRACTION: Final = 0.55
"""Default tolerance, as a fraction of the change by the first smoothing: adds less than 1 % to the effect of noise on
heights."""

MAX_RATIO: Final = 0.9
"""Largest ratio of successive corrections used in the estimate: at the level of rounding, corrections stop falling."""


def stalls(corrections: list[float]) -> bool:
    """Whether the last cycle contracted too little for more V-cycles to be worthwhile."""
    return len(corrections) > 2 and corrections[-1] > SLOW_CONTRACTION * corrections[-2]


def remaining_error(corrections: list[float], coarse_error: float) -> float:
    """Estimated error after the last of these corrections; `coarse_error` is what the coarse levels left."""
    if len(corrections) == 1:
        return CYCLE_FRACTION * corrections[0] + coarse_error
    return geometric_tail(corrections, SLOWDOWN)


def geometric_tail(corrections: list[float], slowed: float = 0.0) -> float:
    """Sum of the remaining corrections, extrapolated as a geometric series; 0 after a single cycle.

    slowed : fraction by which the ratio of successive corrections is moved towards 1
    """
    if len(corrections) < 2 or corrections[-2] == 0.0:
        return 0.0
    ratio = min(corrections[-1] / corrections[-2], MAX_RATIO)
    ratio += slowed * (1.0 - ratio)
    return corrections[-1] * ratio / (1.0 - ratio)
