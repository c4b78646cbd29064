"""What a calibration covers, as a few lines: nine sectors of the field, eight directions, the steepest slope."""

from __future__ import annotations

from typing import Final

from device.calibration_checks import Check
from device.calibration_coverage import DIRECTIONS, SIDES, Coverage
from device.calibration_limits import PASSED_STEEPEST_DEG

COVERED, UNCOVERED = "■", "·"
_COMPASS: Final = (
    ("upper left", "up", "upper right"),
    ("left", "", "right"),
    ("lower left", "down", "lower right"),
)


def coverage_lines(coverage: Coverage | None) -> list[str]:
    """The lines; before the first ball nothing is covered."""
    sectors = list(coverage.sectors.values()) if coverage else [False] * SIDES**2
    directions = coverage.directions if coverage else dict.fromkeys(DIRECTIONS, False)
    field = [" ".join(_sign(covered) for covered in sectors[SIDES * row : SIDES * (row + 1)]) for row in range(SIDES)]
    slopes = [" ".join(_sign(directions[name]) if name else " " for name in row) for row in _COMPASS]
    steepest = f"{coverage.steepest_deg:.0f}" if coverage else "0"
    beside = (f"{steepest}°", f"{PASSED_STEEPEST_DEG:.0f}° needed", "")
    lines = [f"{a}     {b}      {c}".rstrip() for a, b, c in zip(field, slopes, beside, strict=True)]
    return ["field     slopes    steepest", *lines]


def check_lines(checks: tuple[Check, ...]) -> list[str]:
    """Every number that decides, with its limit and a word."""
    return [f"{'pass' if check.passed else 'FAIL'}  {check.name}: {_number(check)}" for check in checks]


def _number(check: Check) -> str:
    if check.name.startswith("share"):
        return f"{check.value:.0%} ({check.kind} {check.limit:.0%})"
    return f"{check.value:.3g} ({check.kind} {check.limit:g})"


def _sign(covered: bool) -> str:
    return COVERED if covered else UNCOVERED
