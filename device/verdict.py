"""The verdict on a press, from its binned frame alone: it never waits for a reconstruction to succeed."""

from __future__ import annotations

import cv2
import numpy as np

from device.health_limits import CLIPPED_DOUBTFUL, CLIPPED_RETAKE, LEAST_CONTACT, SHADED
from device.photometry import BLACK_FRAME, IntensityImage, LinearFrame
from device.scan_bundle import VerdictRecord


def judge(frame: LinearFrame, intensity: IntensityImage | None) -> VerdictRecord:
    """Level, reason and figures; `intensity` is None when the frame could not be divided by a reference."""
    exposure = float(np.percentile(frame.rgb[::2, ::2], 99))
    clipped = float(frame.clipped.mean())
    contact = None if intensity is None else shaded_share(intensity)
    figures = {"exposure_p99": exposure, "clipped_share": clipped, "contact_share": contact}
    if exposure < BLACK_FRAME:
        return VerdictRecord(level="retake", reason="the frame is black: check the lights", figures=figures)
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


def shaded_share(intensity: IntensityImage) -> float:
    """Share of the field whose intensity says that the skin is not flat."""
    smooth = cv2.GaussianBlur(intensity.values, (0, 0), 2.0)
    shaded = np.abs(smooth - 1.0).max(axis=-1) > SHADED
    return float(shaded[intensity.valid].mean()) if intensity.valid.any() else 0.0
