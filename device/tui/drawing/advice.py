"""Advice for the screens: what they can do themselves is named by its key or place, not by a shell command."""

from __future__ import annotations

import re
from typing import Final

_ADVICE: Final = (
    (r"run `retroscan selftest`", "run the self-test (key 4)"),
    (
        r"activate a calibration again with `retroscan calibrations use ID` \(`retroscan calibrations` lists them\)",
        "activate a calibration again (key 4, Calibrations)",
    ),
    (r"see `retroscan calibrations`", "choose another (key 4, Calibrations)"),
    (r"run `retroscan calibrate --auto-exposure`", "balance it (key 4, Exposure)"),
    (r"run `retroscan calibrate`( first| again)?", r"calibrate\1 (key 2)"),
    (r"with `retroscan gel`", "(key 4, Change gel)"),
    (r"run `retroscan pair`", "pair (key 4)"),
)
"""Patterns of command line advice, each with what the screens offer instead."""


def screen_advice(sentence: str) -> str:
    """The sentence with every command that the screens can do themselves replaced by key and place."""
    for pattern, instead in _ADVICE:
        sentence = re.sub(pattern, instead, sentence)
    return sentence
