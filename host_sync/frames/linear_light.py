"""From image files and arrays to linear light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import SATURATED, LinearFrame
from device.surface.fields import Float32Array
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSpec
from host_sync.frames.frame_set_file import MAX_LIGHTS, Encoding
from host_sync.frames.image_file import read_pixels


def read_frame(spec: FrameSpec) -> LinearFrame:
    """The frame as fractions of full scale; a pixel is clipped where a channel reaches `SATURATED` of full scale.

    Raises
    ------
    FrameSetError
        An image is missing, truncated or not what the frame set described; names it.
    """
    images = [read_pixels(path) for path in spec.images]
    for path, image in zip(spec.images, images, strict=True):
        if (len(images) > 1 and image.ndim != 2) or image.shape[:2] != images[0].shape[:2]:
            raise FrameSetError(f"{path}: changed in size or kind since the frame set was checked: load it again")
    planes = [light_of_values(image.dtype, spec.encoding)[image] for image in images]
    rgb = planes[0] if planes[0].ndim == 3 else np.stack(planes, axis=-1)
    return LinearFrame(rgb, np.any(rgb >= np.float32(SATURATED), axis=-1))


def frame_of_values(values: NDArray[Any], encoding: Encoding) -> LinearFrame:
    """The frame in an array of shape (H, W, N), one channel a light: uint8 or uint16, or fractions of full scale.

    Raises
    ------
    FrameSetError
        The array has another shape or type, or holds what is no light.
    """
    if values.ndim != 3 or values.shape[2] > MAX_LIGHTS or 0 in values.shape:
        raise FrameSetError(
            f"an array of shape {values.shape} is no frame: give one of shape (H, W, 3), R, G, B, or (H, W, N), a "
            f"channel a light, up to {MAX_LIGHTS}"
        )
    if values.dtype in (np.uint8, np.uint16):
        rgb = light_of_values(values.dtype, encoding)[values]
    elif values.dtype.kind == "f" and np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 1.0:
        rgb = np.asarray(decode_srgb(values.astype(np.float64)) if encoding == "srgb" else values, np.float32)
    else:
        raise FrameSetError(
            f"an array of {values.dtype} from {values.min()} to {values.max()} is no frame: give uint8, uint16, or "
            "fractions of full scale from 0 to 1"
        )
    return LinearFrame(rgb, np.any(rgb >= np.float32(SATURATED), axis=-1))


def light_of_values(dtype: np.dtype[Any], encoding: Encoding) -> Float32Array:
    """Fraction of full scale of each stored value: float32 array of 256 or 65536 entries for uint8 or uint16."""
    highest = np.iinfo(dtype).max
    values = np.arange(highest + 1) / highest
    return (decode_srgb(values) if encoding == "srgb" else values).astype(np.float32)


def decode_srgb(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear light of sRGB values between 0 and 1 (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
