"""Verdict on a calibration: every number that decides, beside its limit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from device.calibration.acceptance import Check, fit_checks
from device.calibration.coverage import Coverage
from device.calibration.limits import MAX_RADIUS_SPREAD
from host_sync.calibration.balls import UsedPress
from host_sync.calibration.pixel_shape import PixelShape

DIAMETER_QUESTION: Final = "is ball_radius_mm the diameter?"
DIAMETER: Final = f"widest contact over the stated radius ({DIAMETER_QUESTION})"
DIAMETER_CONTACT: Final = 0.45
"""A contact reaches 0.8 of the radius at most, 0.4 of the diameter; one ring's width is added."""

PIXEL_SHAPE: Final = "pixels' height over width against the stated, by the skin around the balls"


def checks(
    presses: Sequence[UsedPress],
    held_out_deg: float | None,
    radius_spread: float,
    coverage: Coverage,
    shape: PixelShape | None = None,
) -> tuple[Check, ...]:
    """Return the checks of the report; a calibration passes when all do.

    What is rejected in a press that shows one ball is part of its dent, not another ball.
    """
    balls = sum(len(press.balls) for press in presses)
    rejected = sum(len(press.rejected) or bool(press.error) for press in presses if len(press.balls) != 1)
    first, share, *rest = fit_checks(balls, rejected, held_out_deg, coverage)
    spread = Check("relative spread of ball radii from shading", radius_spread, MAX_RADIUS_SPREAD, "at most")
    off = () if shape is None else (Check(PIXEL_SHAPE, shape.off, shape.allowed, "at most"),)
    widest = Check(DIAMETER, widest_contact(presses), DIAMETER_CONTACT, "at least")
    return (first, share, spread, widest, *off, *rest)


def widest_contact(presses: Sequence[UsedPress]) -> float:
    """Return the widest contact of any ball over its stated radius."""
    return max((ball.contact_radius_px / ball.radius_px for press in presses for ball in press.balls), default=0.0)
