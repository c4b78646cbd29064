"""One reason to distrust heights, as records and outputs carry it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

import msgspec

DoubtKind = Literal[
    "failed calibration",
    "failed check standard",
    "uncovered sector",
    "extrapolated slopes",
    "drifted light",
    "frame unlike calibration",
    "no zero",
    "not converged",
    "reconstruction",
    "foreign file",
    "replaced scan",
]


REPLACED: Final[DoubtKind] = "replaced scan"
"""Its scan was taken again: it takes part in no trend and no gage study."""


class Doubt(msgspec.Struct, frozen=True):
    """One reason to distrust heights.

    kind : a few words, for outputs with little room
    reason : a clause with the facts
    sectors : names of the sectors of the field that it concerns; all of the field when empty
    """

    kind: DoubtKind
    reason: str
    sectors: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Kind and reason, as every output prints them."""
        return f"{self.kind}: {self.reason}"


def doubtful(kinds: Iterable[Doubt | str]) -> str:
    """Return the doubts in a few words, for a line that has little room; empty without doubts."""
    words = dict.fromkeys(one.kind if isinstance(one, Doubt) else one.partition(":")[0] for one in kinds)
    return f"DOUBTFUL ({', '.join(words)})" if words else ""
