"""Whether a calibration passes: every number that decides, beside its limit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec

from device.calibration_limits import (
    FEWEST_BALLS,
    MOST_RADIUS_SPREAD,
    PASSED_HELD_OUT_DEG,
    PASSED_REJECTED_SHARE,
    PASSED_SECTORS,
    PASSED_STEEPEST_DEG,
    WORST_HELD_OUT_DEG,
)
from device.errors import CalibrationError
from device.inverse_fit import InverseFit
from host_sync.calibration.ball_location import UsedPress
from host_sync.calibration.coverage import Coverage


class Check(msgspec.Struct, frozen=True):
    """One number and the limit that it must keep."""

    name: str
    value: float
    limit: float
    kind: Literal["at most", "at least"]

    @property
    def passed(self) -> bool:
        """Whether the limit is kept."""
        return self.value <= self.limit if self.kind == "at most" else self.value >= self.limit


def check_count(presses: Sequence[UsedPress]) -> None:
    """Refuse presses that show too few balls.

    Raises
    ------
    CalibrationError
        Names the number and why the others were rejected.
    """
    balls = sum(len(press.balls) for press in presses)
    if balls >= FEWEST_BALLS:
        return
    faults = [f"{press.called} {press.fault}" for press in presses if press.fault]
    faults += [f"{press.called}: {ball.reason}" for press in presses if not press.fault for ball in press.rejected]
    why = f" ({'; '.join(faults[:FEWEST_BALLS])})" if faults else ""
    raise CalibrationError(
        f"{balls} usable balls in {len(presses)} calibration presses{why}, and {FEWEST_BALLS} are needed: "
        "press balls of known radius all over the gel"
    )


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


def checks(
    presses: Sequence[UsedPress], held_out_deg: float | None, radius_spread: float, coverage: Coverage
) -> tuple[Check, ...]:
    """What the report judges; a calibration passes when all do."""
    balls = sum(len(press.balls) for press in presses)
    rejected = sum(len(press.rejected) or bool(press.fault) for press in presses)
    covered = sum(coverage.sectors.values())
    found = [
        Check("balls used", float(balls), float(FEWEST_BALLS), "at least"),
        Check("share of balls rejected", rejected / (balls + rejected), PASSED_REJECTED_SHARE, "at most"),
        Check("spread of ball radii by shading, share", radius_spread, MOST_RADIUS_SPREAD, "at most"),
        Check("steepest slope covered, degrees", coverage.steepest_deg, PASSED_STEEPEST_DEG, "at least"),
        Check("sectors of the frame covered, of nine", float(covered), float(PASSED_SECTORS), "at least"),
    ]
    if held_out_deg is not None:
        found.append(Check("held-out error, degrees", held_out_deg, PASSED_HELD_OUT_DEG, "at most"))
    return tuple(found)
