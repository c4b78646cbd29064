"""Places that a person left out of a measurement: strokes of a brush over the field."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, HeightMap, MaskArray
from host_sync.measurement.recipe import MaskTable

SHIFT = 6
"""Binary places of OpenCV's drawing, 1/64 of a pixel."""

MAX_WIDTH_PX: Final = 32_000
"""OpenCV draws no wider line."""


def painted(strokes: Sequence[MaskTable], shape: tuple[int, int], pitch_um: float) -> MaskArray:
    """True where a stroke lies: bool array of shape (H, W)."""
    mask = np.zeros(shape, np.uint8)
    for stroke in strokes:
        places = np.rint(np.array(stroke.points_um) / pitch_um * 2**SHIFT).astype(np.int64)
        limit = 2**SHIFT * 4 * max(shape)
        places = np.clip(places, -limit, limit).astype(np.int32)
        width = max(1, round(min(stroke.width_um / pitch_um, 2.0 * sum(shape), MAX_WIDTH_PX)))
        if len(places) > 1:
            cv2.polylines(mask, [places[:, None]], isClosed=False, color=1, thickness=width, shift=SHIFT)
        for place in places:
            cv2.circle(mask, tuple(place), round(width * 2 ** (SHIFT - 1)), 1, cv2.FILLED, shift=SHIFT)
    return mask.astype(np.bool_)


def without(height: HeightMap, mask: MaskArray) -> HeightMap:
    """The height map, NaN under the mask."""
    z_um: Float32Array = np.where(mask, np.float32(np.nan), height.z_um).astype(np.float32)
    return HeightMap(z_um, height.pitch_um)
