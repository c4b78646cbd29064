"""Numbers, states and coverage in short words for the screens."""

from __future__ import annotations

import re
import textwrap
from datetime import datetime
from typing import Final

import numpy as np

from device.bundles.scan import Annotations, VerdictLevel
from device.calibration.acceptance import DIRECTIONS, PASSED_STEEPEST_DEG, SIDES, Check, Coverage
from device.quick_look.measures import (
    Point,
    Roughness,
    areal_roughness,
    difference,
    levelled,
    line_between,
    line_roughness,
)
from device.surface import HeightMap

GAUGE_FULL: Final = "■"
GAUGE_EMPTY: Final = "·"

MIN_CLOCK_YEAR: Final = 2025
"""A clock that shows an earlier year was never set."""

_LEVELS: Final[dict[VerdictLevel, str]] = {"good": "GOOD", "doubtful": "DOUBTFUL", "retake": "RETAKE"}
_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86400.0


COVERED, UNCOVERED = "■", "·"

_COMPASS: Final = (
    ("upper left", "up", "upper right"),
    ("left", "", "right"),
    ("lower left", "down", "lower right"),
)


def verdict_word(level: VerdictLevel) -> str:
    """Return a verdict's level in capitals."""
    return _LEVELS[level]


def age_text(age_s: float) -> str:
    """Return an age such as "3 h ago"."""
    if age_s < _MINUTE:
        return "just now"
    if age_s < _HOUR:
        return f"{int(age_s // _MINUTE)} min ago"
    return f"{int(age_s // _HOUR)} h ago" if age_s < 2 * _DAY else f"{int(age_s // _DAY)} days ago"


def local_time(at: datetime) -> str:
    """Return the date and time in the instrument's time zone; no date at all from a clock that had never been set."""
    return f"{at.astimezone():%Y-%m-%d %H:%M}" if at.year >= MIN_CLOCK_YEAR else "time not known"


def clock_text(now: datetime) -> str:
    """Return the present local date and time with the time zone; what to do about a clock that was never set."""
    local = now.astimezone()
    if now.year < MIN_CLOCK_YEAR:
        return "the clock was never set: set it here, or join a network"
    return f"{local:%Y-%m-%d %H:%M} {local.tzname()} (UTC{local:%z})"


def percent_text(fraction: float | None) -> str:
    """Return a fraction in per cent; a dash if not measured."""
    return "-" if fraction is None else f"{fraction:.0%}"


def signed_percent(change: float) -> str:
    """Return a relative change to a tenth of a per cent with its sign; one that rounds to 0 has none that is below."""
    return f"{round(change, 3) + 0.0:+.1%}"


def gauge_text(name: str, fraction: float | None, columns: int, words: str | None = None) -> str:
    """Return a name, a bar and a number in `columns`, such as "contact ■■■■····  52%"; `words` replaces the number."""
    label, number = f"{name:<9}", f"{words or percent_text(fraction):>6}"
    room = columns - len(label) - len(number)
    if room < 3:
        return (label + number)[:columns].ljust(columns)
    filled = 0 if fraction is None else round(min(max(fraction, 0.0), 1.0) * room)
    return f"{label}{GAUGE_FULL * filled}{GAUGE_EMPTY * (room - filled)}{number}"


def sticky_text(sticky: Annotations, beside_part: str = "") -> str:
    """Job, part and operator in a line; a dash for what is not set; `beside_part` follows the part."""
    return f"Job {sticky.job or '-'} · Part {sticky.part or '-'}{beside_part} · Operator {sticky.operator or '-'}"


def hanging(text: str, columns: int, indent: int) -> str:
    """Return the text wrapped to `columns`, with all lines but the first indented."""
    wrapped = textwrap.wrap(text, max(columns, indent + 8), subsequent_indent=" " * indent, drop_whitespace=True)
    return "\n".join(wrapped) or text


def shortened(text: str, columns: int) -> str:
    """Return the text, cut with an ellipsis if it does not fit."""
    return text if len(text) <= columns else text[: max(columns - 1, 0)] + "…"


def coverage_lines(coverage: Coverage | None) -> list[str]:
    """Return lines for the covered sectors, slope directions and steepest slope; None before the first ball."""
    sectors = list(coverage.sectors.values()) if coverage else [False] * SIDES**2
    directions = coverage.directions if coverage else dict.fromkeys(DIRECTIONS, False)
    field = [" ".join(_sign(covered) for covered in sectors[SIDES * row : SIDES * (row + 1)]) for row in range(SIDES)]
    slopes = [" ".join(_sign(directions[name]) if name else " " for name in row) for row in _COMPASS]
    steepest = f"{coverage.steepest_deg:.0f}" if coverage else "0"
    beside = (f"{steepest}°", f"{PASSED_STEEPEST_DEG:.0f}° needed", "")
    lines = [f"{a}     {b}      {c}".rstrip() for a, b, c in zip(field, slopes, beside, strict=True)]
    return ["field     slopes    steepest", *lines]


def check_lines(checks: tuple[Check, ...]) -> list[str]:
    """Return one line per acceptance check, with its value, its limit and a word."""
    return [f"{'pass' if check.passed else 'FAIL'}  {check.name}: {check.words}" for check in checks]


def _sign(covered: bool) -> str:
    return COVERED if covered else UNCOVERED


# Advice for the screens: what they can do themselves is named by its key or place, not by a shell command.

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
    """Return the sentence with every command that the screens can do themselves replaced by key and place."""
    for pattern, instead in _ADVICE:
        sentence = re.sub(pattern, instead, sentence)
    return sentence


# Two points of a quick look against each other, in words.

COVERAGE: Final = 2.0
"""Factor of the stated ± over the standard uncertainty, as in the workstation's outputs."""


def measure_text(height: HeightMap, first: Point, second: Point, flatness_um: float | None) -> str:
    """Return height difference, distance, angle and roughness between two points, with ±.

    Roughness is that of the line between them and of their box.
    """
    found = difference(height, first, second, flatness_um)
    has_heights = bool(np.isfinite(found.dz_um))
    dz = f"dz {found.dz_um:.1f}{_pm(found.dz_sigma_um, 1)} µm" if has_heights else "dz unknown: no height at a point"
    parts = [
        dz,
        f"distance {found.distance_um / 1e3:.3f}{_pm(found.distance_sigma_um / 1e3, 3)} mm",
        f"angle {found.angle_deg:.2f}{_pm(found.angle_sigma_deg, 2)}°" if has_heights else "",
        _roughness("R", line_roughness(line_between(height, first, second), height.pitch_um, flatness_um)),
        _roughness("S", areal_roughness(levelled(box_between(height, first, second)), flatness_um)),
    ]
    unknown = " · ± of heights: zero check first" if has_heights and found.dz_sigma_um is None else ""
    return f"{' · '.join(part for part in parts if part)}{unknown}"


def box_between(height: HeightMap, first: Point, second: Point) -> np.ndarray:
    """Return the heights of the box with these corners, both included: float32 array of shape (h, w)."""
    top, bottom = sorted((round(first[0]), round(second[0])))
    left, right = sorted((round(first[1]), round(second[1])))
    return height.z_um[top : bottom + 1, left : right + 1]


def _pm(sigma: float | None, decimals: int) -> str:
    return "" if sigma is None or not np.isfinite(sigma) else f" ± {COVERAGE * sigma:.{decimals}f}"


def _roughness(letter: str, found: Roughness) -> str:
    """ "Ra 1.20 ± 0.10 Rz 5.3 ± 0.8 µm (cut-off 0.8 mm)", P instead of R without one; empty where nothing is there."""
    if not np.isfinite(found.mean_um) or not found.total_um:
        return "" if found.cutoff_um is None else "Ra, Rz not stated: the line shows form and no roughness"
    kind = "P" if letter == "R" and found.cutoff_um is None else letter
    cutoff = "" if found.cutoff_um is None else f" (cut-off {found.cutoff_um / 1e3:g} mm)"
    mean, total = (_pm(found.mean_sigma_um, 2), _pm(found.total_sigma_um, 1))
    return f"{kind}a {found.mean_um:.2f}{mean} {kind}z {found.total_um:.1f}{total} µm{cutoff}"
