"""How large the algebraic error of heights is that full multigrid leaves, as far as its own passes tell.

Shapes and coarse slopes are exact for slopes that belong to a surface, so that smoothing on the finest level repairs
what noise alone has left, and how much it changes is a measure of that noise: without a tolerance cycles end when the
estimated error is a share of it. The correction that a cycle brings is a measure of the error that it removed. One
alone does not tell how fast errors fall, which holes with narrow bridges between them make slow; but those show on the
coarse levels too, whose cycles come first: what these leave behind is added. From the second cycle on the finest
level's own corrections tell.

The shares were found for noise that is alike at all wavelengths. Errors that only look alike from row to row, such as
stripes that the 2:1 coarsening cannot tell apart, may be stated many times too small; what single precision rounds away
is not in the estimate.
"""

from __future__ import annotations

from typing import Final

SLOW_CONTRACTION: Final = 0.6

START_SHARE: Final = 0.4
"""Error left after the first smoothing, as a share of what it changed (0.27 was measured without weights)."""

CYCLE_SHARE: Final = 0.6
"""Error left after the first cycle, as a share of its correction; that of the coarse levels is added."""

SLOWED: Final = 0.25
"""How much more slowly what is left falls than what was removed (see `still_to_come`)."""

NOISE_SHARE: Final = 0.55
"""Tolerance, as a share of what the first smoothing changed, where none is given: so much adds less than 1 % to what
noise does to the heights."""

MOST_SHARE: Final = 0.9
"""Largest share of the correction before that is believed: where only rounding is left, corrections fall no more."""


def stalls(corrections: list[float]) -> bool:
    """Whether the last cycle fell short of the contraction that V-cycles are worth repeating for."""
    return len(corrections) > 2 and corrections[-1] > SLOW_CONTRACTION * corrections[-2]


def error_left(corrections: list[float], coarse_error: float) -> float:
    """Estimated error after the last of these corrections; `coarse_error` is what the coarse levels' cycles left."""
    if len(corrections) == 1:
        return CYCLE_SHARE * corrections[0] + coarse_error
    return still_to_come(corrections, SLOWED)


def still_to_come(corrections: list[float], slowed: float = 0.0) -> float:
    """What all later cycles would bring if corrections went on to fall as the last two did; nought where there is one.

    slowed : how far towards 1 the share that a correction is of the one before is raised
    """
    if len(corrections) < 2 or corrections[-2] == 0.0:
        return 0.0
    share = min(corrections[-1] / corrections[-2], MOST_SHARE)
    share += slowed * (1.0 - share)
    return corrections[-1] * share / (1.0 - share)
