"""Balls of presses as a camera sees them that stands near the skin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from device.balls.viewpoint import MIN_HEIGHTS, Viewpoint
from device.errors import CalibrationError
from device.inverse_map.model import InverseMap
from host_sync.calibration.balls import UsedPress
from host_sync.uncertainty.elevation import apexes_px


def seen_from(located: Sequence[UsedPress], inverse: InverseMap, viewpoint: Viewpoint) -> list[UsedPress]:
    """Return the presses with balls as a camera sees them that is not far away.

    Raises
    ------
    CalibrationError
        The camera would stand hardly higher than the balls.
    """
    seen = [
        replace(
            press,
            balls=tuple(
                replace(ball, viewpoint=viewpoint, apex_px=apex_px)
                for ball, apex_px in zip(press.balls, apexes_px(press.intensity, press.balls, inverse), strict=True)
            ),
        )
        for press in located
    ]
    highest_px = max((ball.apex_px for press in seen for ball in press.balls), default=0.0)
    if viewpoint.height_px < MIN_HEIGHTS * highest_px:
        raise CalibrationError(
            f"the camera's pupil is stated {viewpoint.height_px:.0f} px over the skin and a ball rises "
            f"{highest_px:.0f} px: check pupil_height_mm"
        )
    return seen
