"""A first look at the presses of a folder: where balls show, and of which radius, before anything is calibrated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from device.balls.detector import BallSearch
from device.errors import DeviceError
from device.imaging.estimated_flat_field import estimate_flat_field
from device.imaging.flat_field import LinearFrame, make_flat_field
from device.surface.fields import Float32Array
from host_sync.calibration.balls import PressFrame, locate
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSpec
from host_sync.frames.linear_light import read_frame

RADII: Final = tuple(0.07 * 1.4**step for step in range(9))
"""Radii that are tried where none is known, shares of the frame's shorter side."""

LOOKED_AT_PX: Final = 320
"""Frames are reduced to about this length of their shorter side where any radius is sought."""

ENOUGH: Final = 0.34
"""Share of the images that show a ball from which they are presses."""

STAND_IN_FRAMES: Final = 12
"""At most so many frames stand in for a missing reference."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenPress:
    """Balls of a press, or the reason why none is visible."""

    frame: LinearFrame | None
    search: BallSearch
    fault: str


@dataclass(frozen=True, slots=True)
class FittingRadius:
    """The ball radius that shows in most of the presses that were looked at: pixels, and in how many of how many."""

    radius_px: float
    presses: int
    looked_at: int


def look_at(frames: Sequence[FrameSpec], reference: FrameSpec | None, radii_px: Sequence[float]) -> Iterator[SeenPress]:
    """Each frame with the balls of its radius, found without labels; frames are read one at a time.

    Raises
    ------
    FrameSetError
        The reference cannot be read.
    """
    flat_field = _flat_field(frames, reference)
    for spec, radius_px in zip(frames, radii_px, strict=True):
        try:
            frame = _read(spec)
        except FrameSetError as error:
            yield SeenPress(None, BallSearch((), ()), str(error))
            continue
        yield _seen(frame, flat_field, radius_px, spec.images[0].name)


def fitting_radius(frames: Sequence[FrameSpec], reference: FrameSpec | None) -> FittingRadius | None:
    """The radius of the balls that show in frames, from their contacts; None where none shows."""
    readable = [frame for spec in frames if (frame := _readable(spec)) is not None]
    if not readable:
        return None
    factor = max(1, min(readable[0].shape) // LOOKED_AT_PX)
    small = [_reduced(frame, factor) for frame in readable if frame.shape == readable[0].shape]
    at_rest = _readable(reference) if reference else None
    flat_field = make_flat_field(_reduced(at_rest, factor)) if at_rest else estimate_flat_field(small)
    if flat_field.shape[:2] != small[0].shape:
        return None
    best: FittingRadius | None = None
    for share in RADII:
        radius_px = share * min(small[0].shape)
        found = [bool(_seen(frame, flat_field, radius_px, "").search.found) for frame in small]
        if sum(found) > (best.presses if best else 0):
            best = FittingRadius(radius_px * factor, sum(found), len(small))
    return best


def shows_balls(images: Sequence[Path], reference: Path | None) -> bool:
    """Return whether enough of these images show a ball, of whatever radius, that they are calibration presses."""
    at_rest = FrameSpec((reference,), "srgb") if reference else None
    best = fitting_radius([FrameSpec((image,), "srgb") for image in images], at_rest)
    return best is not None and best.presses >= ENOUGH * best.looked_at


def _flat_field(frames: Sequence[FrameSpec], reference: FrameSpec | None) -> Float32Array | None:
    """Return what frames are divided by; None where no frame can be read."""
    if reference is not None:
        return make_flat_field(_read(reference))
    count = min(len(frames), STAND_IN_FRAMES)
    spread = [frames[number * len(frames) // count] for number in range(count)]
    readable = [frame for spec in spread if (frame := _readable(spec)) is not None]
    same = [frame for frame in readable if frame.shape == readable[0].shape]
    return estimate_flat_field(same) if same else None


def _readable(spec: FrameSpec) -> LinearFrame | None:
    try:
        return _read(spec)
    except FrameSetError:
        return None


def _read(spec: FrameSpec) -> LinearFrame:
    """The frame; of more than three lights, three that are spread over them: balls show in any three."""
    frame = read_frame(spec)
    lights = frame.rgb.shape[-1]
    if lights <= 3:
        return frame
    spread = np.ascontiguousarray(frame.rgb[..., [0, lights // 3, 2 * lights // 3]])
    return LinearFrame(spread, frame.clipped)


def _reduced(frame: LinearFrame, factor: int) -> LinearFrame:
    if factor == 1:
        return frame
    size = (frame.shape[1] // factor, frame.shape[0] // factor)
    rgb = cv2.resize(frame.rgb, size, interpolation=cv2.INTER_AREA)
    clipped = cv2.resize(frame.clipped.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    return LinearFrame(np.asarray(rgb, np.float32), clipped.astype(np.bool_))


def _seen(frame: LinearFrame, flat_field: Float32Array | None, radius_px: float, name: str) -> SeenPress:
    """The balls of a frame; what keeps any from being found is its fault."""
    if frame.rgb.shape[-1] < 3:
        return SeenPress(frame, BallSearch((), ()), "fewer than three lights do not tell a ball from a shadow")
    if flat_field is None or flat_field.shape != frame.rgb.shape:
        return SeenPress(frame, BallSearch((), ()), "its size is not that of the reference")
    try:
        used = locate(PressFrame(name, frame, radius_px), flat_field)
    except DeviceError as error:
        return SeenPress(frame, BallSearch((), ()), str(error).removeprefix(f"{name}: "))
    return SeenPress(frame, used.seen or BallSearch((), ()), used.error)
