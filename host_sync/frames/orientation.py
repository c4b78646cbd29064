"""Images that are stored turned or mirrored, as a mark in their header says (TIFF, EXIF), brought upright."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
import tifffile
from numpy.typing import NDArray

from device.io.tiff import TIFF_READ_ERRORS, quiet_tiff_log
from hal.frame import BAYER_ORDERS, RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.image_info import ImageInfo, Pixels

TAG: Final = 274
EXIF_START: Final = b"Exif\0\0"
UPRIGHT: Final = 1
_ROWS_ARE_COLUMNS: Final = (5, 6, 7, 8)
_ROWS_BACKWARDS: Final = (3, 4, 7, 8)
"""After rows and columns are exchanged: 6 is seen upright when it is turned by a quarter clockwise."""
_COLUMNS_BACKWARDS: Final = (2, 3, 6, 7)


def known_orientation(number: object) -> int:
    """Return the orientation that a tag states, from 1 to 8; upright where it states none of them."""
    return int(number) if isinstance(number, int) and UPRIGHT <= number <= 8 else UPRIGHT


def exif_orientation(data: bytes) -> int:
    """Return the orientation that a block of EXIF states, which is a TIFF without pixels; upright where it states
    none."""
    try:
        with quiet_tiff_log(), tifffile.TiffFile(BytesIO(data)) as tiff:
            return known_orientation(tiff.pages.first.tags.valueof(TAG))
    except TIFF_READ_ERRORS:
        return UPRIGHT


def shape_upright(shape: tuple[int, int], orientation: int) -> tuple[int, int]:
    """(H, W) of an image as it is seen."""
    return (shape[1], shape[0]) if orientation in _ROWS_ARE_COLUMNS else shape


def upright(image: Pixels | RawFrame, orientation: int) -> Any:
    """Return the image as it is seen."""
    if orientation == UPRIGHT:
        return image
    if isinstance(image, RawFrame):
        cell = np.array(list(image.bayer_order)).reshape(2, 2)
        order = "".join(_turned(cell, orientation).ravel())
        (known,) = (one for one in BAYER_ORDERS if one == order)
        return replace(image, mosaic=_turned(image.mosaic, orientation), bayer_order=known)
    return _turned(image, orientation)


def _turned(field: NDArray[Any], orientation: int) -> NDArray[Any]:
    turned = field.swapaxes(0, 1) if orientation in _ROWS_ARE_COLUMNS else field
    rows = -1 if orientation in _ROWS_BACKWARDS else 1
    columns = -1 if orientation in _COLUMNS_BACKWARDS else 1
    return np.ascontiguousarray(turned[::rows, ::columns])


def check_one_orientation(images: Mapping[Path, ImageInfo]) -> None:
    """Refuse images of one camera that are stored turned in different ways.

    A phone or camera marks how it was held. Its sensor did not move over the skin, so that the marks cannot all be
    right, or the camera was turned between frames.

    Raises
    ------
    FrameSetError
        Names two images and their marks.
    """
    (first, as_first), *others = images.items() if images else [(Path(), ImageInfo((0, 0), 1, 8))]
    for image, info in others:
        if info.orientation != as_first.orientation:
            raise FrameSetError(
                f"{image} is marked as turned otherwise than {first} (orientation {info.orientation} and "
                f"{as_first.orientation}): remove the marks where the camera did not move on the sensor, for example "
                "with exiftool -Orientation= -overwrite_original, or take the frames in one position"
            )
