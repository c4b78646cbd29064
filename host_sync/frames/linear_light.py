"""From image files and arrays to linear light on square pixels."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import SATURATED, LinearFrame, demosaic
from device.imaging.printed_marks import MarkPattern
from device.surface import Float32Array
from hal.frame import RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.channels import clip_level
from host_sync.frames.frame_set import FrameSpec
from host_sync.frames.frame_set_file import MAX_LIGHTS, Encoding
from host_sync.frames.image_file import read_image
from host_sync.frames.image_info import Pixels, square_frame


def read_frame(spec: FrameSpec) -> LinearFrame:
    """Return the frame as fractions of full scale.

    A pixel is clipped where a channel reaches `SATURATED` of full scale.

    Where the frame of untouched skin shows a pattern of printed marks, light is interpolated under them.

    Raises
    ------
    FrameSetError
        An image is missing, truncated or not what the frame set described; names it.
    """
    frame = _read_as_taken(spec)
    pattern = MarkPattern(spec.marks_px, 0.0) if spec.marks_px else None
    if spec.at_rest is not None:
        pattern = mark_pattern(spec.at_rest)
    return pattern.taken_out_of(frame) if pattern else frame


def mark_pattern(at_rest: FrameSpec) -> MarkPattern | None:
    """Return the pattern of printed marks that a frame of untouched skin shows; errors as of `read_frame`."""
    try:
        changed_ns = tuple(image.stat().st_mtime_ns for image in at_rest.images)
    except OSError:
        changed_ns = ()
    return _known_pattern(replace(at_rest, at_rest=None), changed_ns)


@lru_cache(maxsize=16)
def _known_pattern(at_rest: FrameSpec, _changed_ns: tuple[int, ...]) -> MarkPattern | None:
    return MarkPattern.of(_read_as_taken(at_rest))


def _read_as_taken(spec: FrameSpec) -> LinearFrame:
    images = [read_image(path) for path in spec.images]
    first = images[0]
    for path, image in zip(spec.images, images, strict=True):
        is_other = isinstance(image, RawFrame) if len(images) > 1 else False
        if is_other or (len(images) > 1 and len(image.shape) != 2) or image.shape[:2] != first.shape[:2]:
            raise FrameSetError(f"{path}: changed in size or kind since the frame set was checked: load it again")
    if isinstance(first, RawFrame):
        if spec.encoding != "linear":
            raise FrameSetError(
                f'{spec.name}: is a camera raw file, whose counts are linear light: state encoding = "linear"'
            )
        return square_frame(demosaic(first), spec.pixel_shape)
    planes = [_light(image, spec) for image in images if not isinstance(image, RawFrame)]
    rgb = planes[0] if planes[0].ndim == 3 else np.stack(planes, axis=-1)
    return square_frame(_linear_frame(rgb), spec.pixel_shape)


def _light(image: Pixels, spec: FrameSpec) -> Float32Array:
    return light_of_values(image.dtype, spec.encoding, spec.full_scale)[image]


def _linear_frame(rgb: Float32Array, clipped_from: float = 1.0) -> LinearFrame:
    return LinearFrame(rgb, np.any(rgb >= np.float32(SATURATED * clipped_from), axis=-1))


def frame_of_values(
    values: NDArray[Any], encoding: Encoding, full_scale: int | None = None, pixel_shape: float = 1.0
) -> LinearFrame:
    """Return the frame in an array (H, W, N), one channel a light: uint8 or uint16, or fractions of full scale.

    full_scale, pixel_shape : as of `FrameSpec`

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
        frame = _linear_frame(light_of_values(values.dtype, encoding, full_scale)[values])
    elif values.dtype.kind == "f" and np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 1.0:
        rgb = np.asarray(decode_srgb(values.astype(np.float64)) if encoding == "srgb" else values, np.float32)
        frame = _linear_frame(rgb, clip_level(*np.unique(rgb, return_counts=True)) or 1.0)
    else:
        raise FrameSetError(
            f"an array of {values.dtype} from {values.min()} to {values.max()} is no frame: give uint8, uint16, or "
            "fractions of full scale from 0 to 1"
        )
    return square_frame(frame, pixel_shape)


def light_of_values(dtype: np.dtype[Any], encoding: Encoding, full_scale: int | None = None) -> Float32Array:
    """Return the fraction of full scale of each stored value, float32 array of 256 or 65536 entries.

    dtype : uint8 or uint16
    full_scale : of uint16; None is the largest count
    """
    highest = np.iinfo(dtype).max
    values = np.arange(highest + 1) / (full_scale if full_scale and dtype == np.uint16 else highest)
    return (decode_srgb(values) if encoding == "srgb" else values).astype(np.float32)


def decode_srgb(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return linear light of sRGB values between 0 and 1 (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
