"""Light that is not the instrument's own: a frame under no light, taken out of a frame under all."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from device.errors import FrameError
from device.imaging.flat_field import SATURATED
from hal.frame import CameraSettings, RawFrame

SAME: Final = 0.01
"""Relative difference of settings that changes ambient light by less than its own noise."""


def without_ambient(frame: RawFrame, dark: RawFrame) -> RawFrame:
    """Return the frame without the light that a frame under no light shows; saturated pixels stay so.

    dark : of equal size and Bayer order, with nearly equal settings; its counts may have another scale

    Raises
    ------
    FrameError
        Size, order or settings differ.
    """
    alike = (dark.shape, dark.bayer_order) == (frame.shape, frame.bayer_order)
    if not alike or not _nearly_equal(dark.granted, frame.granted):
        raise FrameError("the dark frame was not taken as the scan was: scan again")
    span = frame.white_level_dn - frame.black_level_dn
    scale = np.float32(span / (dark.white_level_dn - dark.black_level_dn))
    mosaic = np.empty_like(frame.mosaic)
    limit, top = frame.black_level_dn + SATURATED * span, np.iinfo(np.uint16).max
    for row, (counts, below) in enumerate(zip(frame.mosaic, dark.mosaic, strict=True)):
        ambient = (below.astype(np.float32) - np.float32(dark.black_level_dn)) * scale
        mosaic[row] = np.where(counts >= limit, counts, np.clip(np.rint(counts - ambient), 0.0, top))
    return replace(frame, mosaic=mosaic)


def _nearly_equal(one: CameraSettings, other: CameraSettings) -> bool:
    """Return whether two frames were taken alike: exposures are whole microseconds, or lines of the sensor."""
    exposure = abs(one.exposure_us - other.exposure_us) <= max(SAME * other.exposure_us, 1.0)
    return exposure and abs(one.analogue_gain - other.analogue_gain) <= SAME * other.analogue_gain


def ambient_fraction(dark: RawFrame) -> float:
    """Return the mean light of a frame under no light, fraction of full scale."""
    span = dark.white_level_dn - dark.black_level_dn
    return (float(dark.mosaic.mean()) - dark.black_level_dn) / span
