"""Times methods in turns, so that other load on the machine affects all of them equally."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Any

MAX_TOTAL_S = 12.0
"""A method that took this long in total is not run again."""


@dataclass
class Stopwatch:
    """Durations of one method's runs, ms; the very first run, which may compile or load, is kept apart."""

    first_ms: float | None = None
    runs_ms: list[float] = field(default_factory=list)

    def run(self, function: Callable[[], Any]) -> Any:
        """Result of the function; its duration is recorded."""
        began = time.perf_counter()
        result = function()
        self.runs_ms.append(1e3 * (time.perf_counter() - began))
        return result

    @property
    def figures(self) -> dict[str, Any]:
        """Minimum and median over the runs, and their number."""
        return {
            "min_ms": min(self.runs_ms),
            "median_ms": median(self.runs_ms),
            "first_ms": self.first_ms,
            "runs": len(self.runs_ms),
        }


def side_by_side(
    methods: Mapping[str, Callable[[], Any]],
    rounds: int,
    *,
    once: frozenset[str] = frozenset(),
    settled: bool = False,
) -> dict[str, dict[str, Any]]:
    """Figures of every method by name, run in turns for `rounds` rounds after a first run that does not count.

    once : slow methods whose first run is the one that counts
    settled : whether each run that counts follows one of its own method: another leaves memory in other pieces
    """
    watches = {name: Stopwatch() for name in methods}
    for name, function in methods.items():
        watches[name].run(function)
        if name not in once:
            watches[name].first_ms = watches[name].runs_ms.pop()
    for _ in range(rounds):
        for name, function in methods.items():
            spent_s = 1e-3 * (sum(watches[name].runs_ms) + (watches[name].first_ms or 0.0))
            if name not in once and (not watches[name].runs_ms or spent_s < MAX_TOTAL_S):
                if settled:
                    function()
                watches[name].run(function)
    return {name: watch.figures for name, watch in watches.items()}
