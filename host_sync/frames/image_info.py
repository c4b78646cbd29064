"""Size, kind and orientation of an image file, and the words for one that cannot be used.

Images that are stored turned or mirrored (TIFF, EXIF) are brought upright. Oblong pixels become square.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from device.imaging.flat_field import LinearFrame
from device.io.tiff import TIFF_READ_ERRORS, quiet_tiff_log
from hal.frame import BAYER_ORDERS, RawFrame
from host_sync.errors import FrameSetError

ACCEPTED: Final = "save it as grey or RGB of 8 or 16 bit"

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

Decode = Callable[[], Pixels | RawFrame]


@dataclass(frozen=True, slots=True)
class ImageInfo:
    """Size and kind of an image, from its header.

    shape : (H, W)
    channels : 1 for grey, 3 for RGB
    bits : per channel as they are stored, 8 or 16
    full_scale : the count at which a pixel is saturated; None where the file does not say
    has_alpha : an opacity is stored beside the colours, which `read_image` drops where every pixel is opaque
    is_raw : a camera's own mosaic of counts
    orientation : how pixels are stored, as TIFF and EXIF number it; `shape` is that of the upright image
    """

    shape: tuple[int, int]
    channels: int
    bits: int
    full_scale: int | None = None
    has_alpha: bool = False
    is_raw: bool = False
    orientation: int = 1


def damaged(path: Path) -> FrameSetError:
    """Return the error of a file that ends too early or cannot be decoded."""
    return FrameSetError(f"{path}: is truncated or damaged: fetch it again")


def palette_channels(entries: NDArray[np.uint8]) -> int:
    """1 where a palette holds greys alone, so that the image is one of greys; else 3."""
    colours = entries[: len(entries) // 3 * 3].reshape(-1, 3)
    return 1 if (colours == colours[:, :1]).all() else 3


ORIENTATION_TAG: Final = 274
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
    """Return the orientation that a block of EXIF states; upright where it states none.

    Such a block is a TIFF without pixels.
    """
    try:
        with quiet_tiff_log(), tifffile.TiffFile(BytesIO(data)) as tiff:
            return known_orientation(tiff.pages.first.tags.valueof(ORIENTATION_TAG))
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


# Frames of pixels that are not square, brought to square ones where they are read.
#
# A stream that was resized in one direction, or a sensor with oblong pixels, has another pitch along rows than down
# columns. The finer direction is averaged to the pitch of the coarser one: no value is made up, and all else sees
# square pixels of one pitch.

MAX_OBLONG: Final = 3.0
"""A field of an interlaced stream, or a sensor binned in one direction, has pixels twice as high as wide."""


def square_pitch(pitch_um: float | tuple[float, ...]) -> tuple[float, float]:
    """Return the pitch of the square pixels, and the shape of the stored ones: height over width.

    pitch_um : distance of neighbouring pixels on the skin, µm; where they are not square, along a row and down a column

    Raises
    ------
    FrameSetError
        The two differ by more than any camera's.
    """
    if isinstance(pitch_um, tuple):
        across_um, down_um = pitch_um
        if max(across_um, down_um) > MAX_OBLONG * min(across_um, down_um):
            raise FrameSetError(
                f"pixel_pitch_um: [{across_um:g}, {down_um:g}] are no two pitches of one camera: write decimal points, "
                f"such as {across_um:g}.5 for one pitch, or the pitch along a row and the one down a column"
            )
        return max(across_um, down_um), down_um / across_um
    return pitch_um, 1.0


def square_shape(shape: tuple[int, int], pixel_shape: float) -> tuple[int, int]:
    """(H, W) of a frame in square pixels that is stored with (H, W) `shape`."""
    rows, columns = shape
    if pixel_shape > 1.0:
        return rows, max(1, round(columns / pixel_shape))
    return max(1, round(rows * pixel_shape)), columns


def square_place(column: float, row: float, shape: tuple[int, int], pixel_shape: float) -> tuple[float, float]:
    """Return the column and row in square pixels of a place in a frame that is stored with (H, W) `shape`."""
    rows, columns = square_shape(shape, pixel_shape)
    return (column + 0.5) * columns / shape[1] - 0.5, (row + 0.5) * rows / shape[0] - 0.5


def square_frame(frame: LinearFrame, pixel_shape: float) -> LinearFrame:
    """Return the frame in square pixels; one is clipped where any part of it is."""
    if pixel_shape == 1.0:
        return frame
    rows, columns = square_shape(frame.shape, pixel_shape)
    size = (columns, rows)
    rgb = cv2.resize(frame.rgb, size, interpolation=cv2.INTER_AREA).reshape(rows, columns, -1)
    clipped = cv2.resize(frame.clipped.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
    return LinearFrame(np.asarray(rgb, np.float32), np.asarray(clipped, np.bool_), frame.demosaiced)
