"""From image files, arrays and light-by-light sequences to linear light on square pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.errors import FrameError, RecordError
from device.imaging.flat_field import DARK_FLOOR, SATURATED, LinearFrame, NormalizedImage, bin_bayer, demosaic
from device.imaging.frame_light import without_ambient
from device.imaging.printed_marks import MarkPattern
from device.surface import Float32Array
from hal.frame import RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.channel_counts import clip_level
from host_sync.frames.frame_set import FrameSpec
from host_sync.frames.frame_set_file import MAX_LIGHTS, Encoding
from host_sync.frames.image_file import read_image
from host_sync.frames.image_info import Pixels, square_frame

if TYPE_CHECKING:
    from device.bundles.scan import ScanBundle

CHANNELS: Final = 3

LIT: Final = 0.5
"""Intensity over the reference from which a light arrives."""

MIN_OWN: Final = 0.1
"""Less of its own light no channel shows."""

STEP: Final = 4
"""Step of the pixels that show how much of a channel's light is its own."""


@dataclass(frozen=True, slots=True, eq=False)
class LightSequence:
    """Single lights' frames.

    lights : the light that each channel shows most of, in the order R, G, B
    alone : float32 array of shape (H/2, W/2, 3), each channel under its own light alone, fractions of full scale
    """

    lights: tuple[str, ...]
    alone: Float32Array

    def over_untouched(self, intensity: NormalizedImage, flat_field: Float32Array) -> Float32Array:
        """Return what each light alone shows over what it shows of untouched skin: float32 array of shape (H, W, 3).

        intensity : of the frame under all lights, over its reference
        flat_field : the reference's light, shape (H, W, 3)

        Where a light arrives, its frame and that of all lights differ by the share of the other lights in its channel.
        """
        size = (flat_field.shape[1], flat_field.shape[0])
        found = np.empty(flat_field.shape, np.float32)
        for channel in range(CHANNELS):
            here = cv2.resize(np.ascontiguousarray(self.alone[..., channel]), size, interpolation=cv2.INTER_LINEAR)
            over = here / np.maximum(flat_field[..., channel], DARK_FLOOR)
            all_lights = intensity.values[::STEP, ::STEP, channel]
            lit = intensity.valid[::STEP, ::STEP] & (all_lights > LIT)
            own = float(np.median(over[::STEP, ::STEP][lit] / all_lights[lit])) if lit.any() else 1.0
            found[..., channel] = over / np.float32(max(own, MIN_OWN))
        return found


def read_light_sequence(scan: ScanBundle) -> LightSequence | str:
    """Return the sequence of a scan, or a sentence that says why it cannot be used; empty if none was taken."""
    exposures = scan.record.exposures
    if exposures.alone_moved:
        return "the object moved while each light was alone, so that those frames were left out"
    if not exposures.alone_files:
        return ""
    if len(exposures.alone_files) != CHANNELS:
        return f"{len(exposures.alone_files)} lights were taken alone, and {CHANNELS} are needed"
    try:
        dark = scan.dark_frame()
        if dark is None:
            return "each light was taken alone, but no frame under no light"
        seen = {
            light: bin_bayer(without_ambient(scan.named_frame(name), dark)).rgb
            for light, name in exposures.alone_files.items()
        }
    except (RecordError, FrameError) as error:
        return f"the frames of single lights cannot be read: {error}"
    own = {int(np.argmax(rgb.mean(axis=(0, 1)))): light for light, rgb in seen.items()}
    if len(own) != CHANNELS:
        return "two lights alone show most in the same channel"
    lights = tuple(own[channel] for channel in range(CHANNELS))
    alone = np.stack([seen[light][..., channel] for channel, light in enumerate(lights)], axis=-1)
    return LightSequence(lights, alone)


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
