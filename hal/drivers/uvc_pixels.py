"""From a finished 8-bit picture to the raw frame's mosaic.

The sensor measured one colour a pixel and the camera interpolated the other two, so a picture holds three values where
one was measured. Here each pixel keeps one again: the mean of that colour over the pixel and its neighbours, by 1 2 1
along rows and columns. That takes together what interpolation spread over neighbours, and each colour stays where it
was seen: a mean of 2x2 pixels would shift red against blue by a pixel.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from hal.drivers.v4l2_stack import StreamFormat

WHITE_DN: Final = 65535
CLIPPED_FROM: Final = 253
"""Stored value from which a pixel counts as saturated: a mean that holds one would hide it."""

AIMING_STEP: Final = 8
KERNEL: Final = np.array([0.25, 0.5, 0.25])
SITES: Final = ((2, ((0, 0),)), (1, ((0, 1), (1, 0))), (0, ((1, 1),)))
"""Channels of a picture (B, G, R) and the pixels of every 2x2 that show them in the mosaic, RGGB."""


def decoded(data: bytes, stream: StreamFormat) -> NDArray[np.uint8] | None:
    """The picture, uint8 array of shape (H, W, 3), B, G, R; None when it is damaged."""
    buffer = np.frombuffer(data, np.uint8)
    rows, columns = stream.rows, stream.columns
    if stream.pixel_format in ("MJPG", "JPEG"):
        try:
            picture = cv2.imdecode(buffer, cv2.IMREAD_COLOR)
        except cv2.error:
            return None
        if picture is None or picture.shape[:2] != (rows, columns):
            return None
        return np.asarray(picture, np.uint8)
    row_bytes = stream.row_bytes or columns * (2 if stream.pixel_format == "YUYV" else 3)
    if buffer.size < rows * row_bytes:
        return None
    lines = buffer[: rows * row_bytes].reshape(rows, row_bytes)
    if stream.pixel_format == "YUYV":
        packed = np.ascontiguousarray(lines[:, : 2 * columns]).reshape(rows, columns, 2)
        return np.asarray(cv2.cvtColor(packed, cv2.COLOR_YUV2BGR_YUYV), np.uint8)
    return np.ascontiguousarray(lines[:, : 3 * columns].reshape(rows, columns, 3)[..., ::-1])


def mosaic_of(picture: NDArray[np.uint8], encoding: Literal["srgb", "linear"]) -> NDArray[np.uint16]:
    """The mosaic of a picture, uint16 array of shape (H, W), RGGB, linear light of 0 to `WHITE_DN`.

    picture : uint8 array of shape (H, W, 3), B, G, R; H and W are even
    """
    light = _light(encoding)
    mosaic = np.empty(picture.shape[:2], np.uint16)
    for channel, sites in SITES:
        mean = _means(light[picture[..., channel]], picture[..., channel] >= CLIPPED_FROM)
        for row, column in sites:
            mosaic[row::2, column::2] = mean[row::2, column::2]
    return mosaic


def aiming_picture(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A small grey picture, uint8 array of shape (H / 8, W / 8)."""
    rows, columns, _ = picture.shape
    small = cv2.resize(picture, (columns // AIMING_STEP, rows // AIMING_STEP), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.uint8)


def _means(light: NDArray[np.uint16], saturated: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Mean light around each pixel, uint16 array of shape (H, W); white where one of the pixels is saturated."""
    mean = np.asarray(cv2.sepFilter2D(light, -1, KERNEL, KERNEL, borderType=cv2.BORDER_REFLECT_101), np.uint16)
    if saturated.any():
        mean[cv2.dilate(saturated.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0] = WHITE_DN
    return mean


@lru_cache(maxsize=2)
def _light(encoding: Literal["srgb", "linear"]) -> NDArray[np.uint16]:
    """Linear light of each stored value, uint16 array of 256 entries."""
    values = np.arange(256) / 255.0
    if encoding == "srgb":  # IEC 61966-2-1
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return np.rint(values * WHITE_DN).astype(np.uint16)
