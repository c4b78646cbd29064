"""Acceptance of a calibration: every number that decides, beside its limit. Device and workstation judge alike."""

from __future__ import annotations

from typing import Literal

import msgspec

from device.calibration.coverage import Coverage
from device.calibration.fit import InverseFit
from device.calibration.limits import (
    MIN_BALLS,
    PASSED_HELD_OUT_DEG,
    PASSED_REJECTED_SHARE,
    PASSED_SECTORS,
    PASSED_STEEPEST_DEG,
    WORST_HELD_OUT_DEG,
)
from device.errors import CalibrationError


class Check(msgspec.Struct, frozen=True):
    """One number and the limit that it must keep."""

    name: str
    value: float
    limit: float
    kind: Literal["at most", "at least"]

    @property
    def passed(self) -> bool:
        """True if the limit is kept."""
        return self.value <= self.limit if self.kind == "at most" else self.value >= self.limit

    @property
    def words(self) -> str:
        """Value and limit, for example "0.147 (at most 0.07)"; a share in per cent."""
        number = ".0%" if self.name.startswith("share") else ".3g"
        return f"{self.value:{number}} ({self.kind} {self.limit:{number}})"


def check_fit(inverse: InverseFit) -> None:
    """Refuse a fit whose held-out balls are wrong.

    Raises
    ------
    CalibrationError
        Names the error.
    """
    if inverse.held_out_deg is not None and inverse.held_out_deg > WORST_HELD_OUT_DEG:
        raise CalibrationError(
            f"the balls contradict each other (held-out error {inverse.held_out_deg:.1f} degrees, at most "
            f"{WORST_HELD_OUT_DEG:g}): check the balls' radii and places, wipe ball and gel, and press again"
        )


def fit_checks(balls: int, rejected: int, held_out_deg: float | None, coverage: Coverage) -> tuple[Check, ...]:
    """Return what is judged of every calibration.

    balls, rejected : number of training balls, and of rejected ones
    held_out_deg : error on held-out balls; None when it is unknown, and then not judged
    """
    covered = sum(coverage.sectors.values())
    share = rejected / (balls + rejected) if balls + rejected else 1.0
    found = [
        Check("balls used", float(balls), float(MIN_BALLS), "at least"),
        Check("share of balls rejected", share, PASSED_REJECTED_SHARE, "at most"),
        Check("steepest slope covered, degrees", coverage.steepest_deg, PASSED_STEEPEST_DEG, "at least"),
        Check("sectors of the frame covered, of nine", float(covered), float(PASSED_SECTORS), "at least"),
    ]
    if held_out_deg is not None:
        found.append(Check("held-out error, degrees", held_out_deg, PASSED_HELD_OUT_DEG, "at most"))
    return tuple(found)
