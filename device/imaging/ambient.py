"""Light that is not the instrument's own: a frame under no light, taken out of a frame under all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from device.errors import FrameError
from device.imaging.flat_field import SATURATED
from hal.frame import RawFrame


def without_ambient(frame: RawFrame, dark: RawFrame) -> RawFrame:
    """The frame without the light that a frame under no light shows; saturated pixels stay so.

    dark : of equal size, Bayer order and settings; its counts may have another scale

    Raises
    ------
    FrameError
        Size, order or settings differ.
    """
    if (dark.shape, dark.bayer_order, dark.granted) != (frame.shape, frame.bayer_order, frame.granted):
        raise FrameError("the dark frame was not taken as the scan was: scan again")
    span = frame.white_level_dn - frame.black_level_dn
    scale = np.float32(span / (dark.white_level_dn - dark.black_level_dn))
    mosaic = np.empty_like(frame.mosaic)
    limit, top = frame.black_level_dn + SATURATED * span, np.iinfo(np.uint16).max
    for row, (counts, below) in enumerate(zip(frame.mosaic, dark.mosaic, strict=True)):
        ambient = (below.astype(np.float32) - np.float32(dark.black_level_dn)) * scale
        mosaic[row] = np.where(counts >= limit, counts, np.clip(np.rint(counts - ambient), 0.0, top))
    return replace(frame, mosaic=mosaic)


def ambient_fraction(dark: RawFrame) -> float:
    """Mean light of a frame under no light, fraction of full scale."""
    span = dark.white_level_dn - dark.black_level_dn
    return (float(dark.mosaic.mean()) - dark.black_level_dn) / span
