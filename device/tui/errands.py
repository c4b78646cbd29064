"""What is done once in a while, and a sentence on each: the list of the set-up screen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

ErrandName = Literal["back", "facts", "pair", "test", "zero", "gel", "calibrations", "off"]


@dataclass(frozen=True, slots=True)
class Errand:
    """An errand: what it is called and what it does."""

    name: ErrandName
    title: str
    meaning: str


ERRANDS: Final = (
    Errand("back", "Back to Scan", ""),
    Errand("facts", "This instrument", ""),
    Errand(
        "pair",
        "Pair",
        "A workstation that knows the code may fetch scans from now on.\nEnter shows a code for two minutes.",
    ),
    Errand(
        "test",
        "Self-test",
        "Every part is tried, and each light is looked at through the camera.\n"
        "Touch nothing with the gel. Enter starts.",
    ),
    Errand(
        "zero",
        "Zero check",
        "Shows how flat the untouched skin reads: do it each morning, and when something looks odd.\n"
        "Touch nothing with the gel. Enter takes a frame; it is no scan.",
    ),
    Errand(
        "gel",
        "Change gel",
        "Say which gel is mounted: its own calibration comes into force, or scans are refused until it has one.\n"
        "Enter shows the gels that are known here.",
    ),
    Errand(
        "calibrations",
        "Calibrations",
        "Every calibration of this instrument stays, and any that fits can come into force again.\nEnter shows them.",
    ),
    Errand(
        "off",
        "Power off",
        "What is in work is stored, the lights go dark, and the instrument switches off.\nEnter asks first.",
    ),
)
