"""Whether a calibration passes: every number that decides, beside its limit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from device.calibration.acceptance import Check, fit_checks
from device.calibration.coverage import Coverage
from device.calibration.limits import MAX_RADIUS_SPREAD, MIN_BALLS
from device.errors import CalibrationError
from host_sync.calibration.balls import UsedPress
from host_sync.calibration.pixel_shape import PixelShape

PIXEL_SHAPE: Final = "pixels' height over width against the stated, by the skin around the balls"


def check_count(presses: Sequence[UsedPress]) -> None:
    """Refuse presses that show too few balls.

    Raises
    ------
    CalibrationError
        Names the number and why the others were rejected.
    """
    balls = sum(len(press.balls) for press in presses)
    if balls >= MIN_BALLS:
        return
    faults = [f"{press.label} {press.error}" for press in presses if press.error]
    faults += [f"{press.label}: {ball.reason}" for press in presses if not press.error for ball in press.rejected]
    why = f" ({'; '.join(faults[:MIN_BALLS])})" if faults else ""
    raise CalibrationError(
        f"{balls} usable balls in {len(presses)} calibration presses{why}, and {MIN_BALLS} are needed: "
        "press balls of known radius all over the gel"
    )


def checks(
    presses: Sequence[UsedPress],
    held_out_deg: float | None,
    radius_spread: float,
    coverage: Coverage,
    shape: PixelShape | None = None,
) -> tuple[Check, ...]:
    """What the report judges; a calibration passes when all do."""
    balls = sum(len(press.balls) for press in presses)
    rejected = sum(len(press.rejected) or bool(press.error) for press in presses)
    first, share, *rest = fit_checks(balls, rejected, held_out_deg, coverage)
    spread = Check("relative spread of ball radii from shading", radius_spread, MAX_RADIUS_SPREAD, "at most")
    off = () if shape is None else (Check(PIXEL_SHAPE, shape.off, shape.allowed, "at most"),)
    return (first, share, spread, *off, *rest)
