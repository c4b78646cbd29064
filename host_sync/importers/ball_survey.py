"""A first look at the presses of a folder: where balls show, and of which radius, before anything is calibrated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from device.balls.detector import BallSearch
from device.errors import DeviceError
from device.imaging.estimated_flat_field import estimate_flat_field
from device.imaging.flat_field import LinearFrame, flat_field_correct, make_flat_field
from device.surface.fields import Float32Array
from host_sync.calibration.balls import PressFrame, locate
from host_sync.calibration.fitting_radius import FittingRadius, fitting_radius
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSpec
from host_sync.frames.linear_light import read_frame

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


def survey_radius(frames: Sequence[FrameSpec], reference: FrameSpec | None) -> FittingRadius | None:
    """The radius of the balls that show in frames; None where none shows, or no frame has the reference's size."""
    flat_field = _flat_field(frames, reference)
    readable = [frame for spec in frames if (frame := _readable(spec)) is not None]
    same = [frame for frame in readable if flat_field is not None and frame.rgb.shape == flat_field.shape]
    return fitting_radius([flat_field_correct(frame, flat_field) for frame in same if flat_field is not None])


def shows_balls(images: Sequence[Path], reference: Path | None) -> bool:
    """Return whether enough of these images show a ball, of whatever radius, that they are calibration presses."""
    at_rest = FrameSpec((reference,), "srgb") if reference else None
    best = survey_radius([FrameSpec((image,), "srgb") for image in images], at_rest)
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
