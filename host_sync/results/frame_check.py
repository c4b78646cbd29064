"""What one check says of a frame: passed, refused, or that it could not be made, each with its figure and limit."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import msgspec

Outcome = Literal["passed", "refused", "not checked"]


class FrameCheck(msgspec.Struct, frozen=True):
    """The outcome of one check of one frame.

    name : what was checked, such as "pattern position"
    outcome : "not checked" where frame or calibration hold nothing that the check could use
    value, limit : the figure that was compared and its limit, in `unit`; None where nothing was compared
    words : why it was refused or could not be made, one clause; empty when it passed
    """

    name: str
    outcome: Outcome
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    words: str = ""


def refusals(checks: Iterable[FrameCheck]) -> list[str]:
    """What speaks against a frame, one clause each, in the order of the checks."""
    return [check.words for check in checks if check.outcome == "refused"]


def not_checked(name: str, words: str) -> FrameCheck:
    """The record of a check that could not be made."""
    return FrameCheck(name, "not checked", words=words)
