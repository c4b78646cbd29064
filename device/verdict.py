"""The verdict on a press, from its binned frame alone: it never waits for a reconstruction to succeed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import cv2
import numpy as np

from device.exposure_levels import Levels
from device.light_check import border_levels, light_complaint
from device.photometry import BLACK_FRAME, IntensityImage, LinearFrame
from device.scan_bundle import VerdictRecord

CLIPPED_RETAKE: Final = 0.05
CLIPPED_DOUBTFUL: Final = 0.005
"""Shares of clipped pixels from which a press is to be retaken, or doubted."""

LEAST_CONTACT: Final = 0.005
"""A press that shades a smaller share of the field has hardly touched anything."""

SHADED: Final = 0.06
"""Intensity this far from that of flat skin, in any channel, counts as shaded."""


def judge(
    frame: LinearFrame,
    intensity: IntensityImage | None,
    lights: Sequence[str] = ("red", "green", "blue"),
    flags: Mapping[str, str] = MappingProxyType({}),
) -> VerdictRecord:
    """Level, reason and figures.

    intensity : None when the frame could not be divided by a reference
    lights : their names in R, G, B order
    flags : what the light driver said while they shone, such as "open", by light
    """
    exposure = float(np.percentile(frame.rgb[::2, ::2], 99))
    clipped = float(frame.clipped.mean())
    contact = None if intensity is None else shaded_share(intensity)
    border = None if intensity is None else border_levels(intensity)
    figures = {"exposure_p99": exposure, "clipped_share": clipped, "contact_share": contact} | border_figures(border)
    if exposure < BLACK_FRAME:
        told = "".join(f"; the driver says {kind} at light {light}" for light, kind in flags.items())
        return VerdictRecord(level="retake", reason=f"the frame is black{told}: check the lights", figures=figures)
    if complaint := light_complaint(border, lights, flags):
        return VerdictRecord(level=complaint[0], reason=complaint[1], figures=figures)
    if clipped > CLIPPED_RETAKE:
        reason = f"{clipped:.0%} of the frame is saturated: lower the exposure or press more evenly"
        return VerdictRecord(level="retake", reason=reason, figures=figures)
    if contact is not None and contact < LEAST_CONTACT:
        reason = "hardly anything presses the skin: press harder or check the place"
        return VerdictRecord(level="doubtful", reason=reason, figures=figures)
    if clipped > CLIPPED_DOUBTFUL:
        reason = f"{clipped:.1%} of the frame is saturated: slopes there are guessed from their neighbours"
        return VerdictRecord(level="doubtful", reason=reason, figures=figures)
    relief = "" if contact is None else f", relief over {contact:.0%} of the field"
    return VerdictRecord(level="good", reason=f"exposure {exposure:.0%}{relief}", figures=figures)


def border_figures(levels: Levels | None) -> dict[str, float | None]:
    """The skin's level along the border by channel, 1 as calibrated."""
    return {
        f"border_level_{colour}": None if levels is None else level
        for colour, level in zip(("red", "green", "blue"), levels or (None,) * 3, strict=True)
    }


def shaded_share(intensity: IntensityImage) -> float:
    """Share of the field whose intensity says that the skin is not flat."""
    smooth = cv2.GaussianBlur(intensity.values, (0, 0), 2.0)
    shaded = np.abs(smooth - 1.0).max(axis=-1) > SHADED
    return float(shaded[intensity.valid].mean()) if intensity.valid.any() else 0.0
