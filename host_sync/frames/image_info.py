"""Size and kind of an image file, and the words for one that cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hal.frame import RawFrame
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
