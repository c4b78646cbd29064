"""Tolerances: whether a number passes, by the decision rule of ISO 14253-1 with its default of 95 %.

A number passes when it lies inside its limits by 1.65 standard uncertainties, and fails when it lies outside by as
much. Between the two, without an uncertainty, where a doubt says that the uncertainty does not hold, or where the
uncertainty lacks that of the pixel pitch, which heights and lengths depend on, nothing is decided.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import msgspec

from host_sync.measurement.quantity import Limits, Quantity, Verdict
from host_sync.measurement.recipe import ToleranceTable
from host_sync.results.doubt import DoubtKind

GUARD: Final = 1.65
"""Guard band in standard uncertainties: 95 % on one side of a normal distribution."""

NO_PITCH_SIGMA: Final = "± without that of the pixel pitch, which is not known: set scale.pixel_pitch_share"

VOID_DOUBTS: Final[tuple[DoubtKind, ...]] = (
    "failed calibration",
    "failed check standard",
    "uncovered sector",
    "drifted light",
    "frame unlike calibration",
    "no zero",
    "not converged",
)
"""Doubts under which an uncertainty does not hold."""

VOID: Final = (*VOID_DOUBTS, NO_PITCH_SIGMA)
"""Beginnings of warnings under which a verdict is not given."""

PITCH_FREE: Final = frozenset({"", "%", "°"})
"""Units of numbers that do not depend on the pitch, unless their warnings say so: heights and lengths do."""


def judged(
    quantities: Iterable[Quantity], tolerances: Iterable[ToleranceTable], *, pitch_is_known: bool
) -> tuple[Quantity, ...]:
    """The quantities, each with its limits and verdict where the recipe has a tolerance of it.

    pitch_is_known : whether uncertainties hold that of the pixel pitch
    """
    wanted = {(one.of, one.number): one for one in tolerances}
    found = []
    for quantity in quantities:
        table = wanted.get((quantity.subject, quantity.name))
        if table is None:
            found.append(quantity)
            continue
        if not pitch_is_known and quantity.uncertainty is not None and quantity.unit not in PITCH_FREE:
            warnings = tuple(dict.fromkeys((*quantity.warnings, NO_PITCH_SIGMA)))
            quantity = msgspec.structs.replace(quantity, warnings=warnings)
        limits = Limits(low=table.low, high=table.high, verdict=verdict_of(quantity, table.low, table.high))
        found.append(msgspec.structs.replace(quantity, limits=limits))
    return tuple(found)


def verdict_of(quantity: Quantity, low: float | None, high: float | None) -> Verdict:
    """The verdict on a number under its limits, which are in the number's unit."""
    if quantity.value is None or quantity.uncertainty is None or any(w.startswith(VOID) for w in quantity.warnings):
        return "undecided"
    guard = GUARD * quantity.uncertainty / quantity.coverage_factor
    below = -float("inf") if low is None else low
    above = float("inf") if high is None else high
    if below + guard <= quantity.value <= above - guard:
        return "pass"
    if quantity.value < below - guard or quantity.value > above + guard:
        return "fail"
    return "undecided"


def unmet(quantities: Iterable[Quantity], tolerances: Iterable[ToleranceTable]) -> tuple[str, ...]:
    """Names of numbers that have a tolerance and were not measured."""
    known = {(one.subject, one.name) for one in quantities if one.value is not None}
    return tuple(f"{one.of}: {one.number}" for one in tolerances if (one.of, one.number) not in known)
