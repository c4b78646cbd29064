"""A first look at the presses of a folder: where balls show, and of which radius, before anything is calibrated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from device.balls.detector import BallSearch
from device.errors import DeviceError
from device.imaging.flat_field import LinearFrame, flat_field_correct
from device.surface.fields import Float32Array
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.fitting_radius import FittingRadius, fitting_radius
from host_sync.calibration.located_presses import flat_field_of, locate_usable
from host_sync.calibration_file.inputs import press_frame, stand_ins
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSet, FrameSpec
from host_sync.frames.linear_light import read_frame

ENOUGH: Final = 0.34
"""Share of the images that show a ball from which they are presses."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenPress:
    """Balls of a press, or the reason why none is visible."""

    frame: LinearFrame | None
    search: BallSearch
    fault: str


def look_at(frame_set: FrameSet, at_most: int) -> Iterator[SeenPress]:
    """The first presses of a frame set with the balls that calibration uses; frames are read one at a time.

    Raises
    ------
    FrameSetError
        The reference cannot be read.
    """
    specs = [*(press.frame for press in frame_set.presses), *stand_ins(frame_set)]
    flat_field = _flat_field(specs, frame_set.reference)
    for spec in frame_set.presses[:at_most]:
        try:
            press = press_frame(spec, frame_set)
        except FrameSetError as error:
            yield SeenPress(None, BallSearch((), ()), str(error))
            continue
        yield _seen(replace(press, frame=_three_lights(press.frame)), flat_field)


def survey_radius(frames: Sequence[FrameSpec], reference: FrameSpec | None) -> FittingRadius | None:
    """The radius of the balls that show in frames; None where none shows, or no frame has the reference's size."""
    flat_field = _flat_field(frames, reference)
    readable = [frame for spec in frames if (frame := _readable(spec)) is not None]
    same = [frame for frame in readable if flat_field is not None and frame.rgb.shape == flat_field.shape]
    return fitting_radius([flat_field_correct(frame, flat_field) for frame in same if flat_field is not None])


def shows_balls(images: Sequence[Path], reference: Path | None) -> bool:
    """Return whether enough of these images show a ball, of whatever radius, that they are calibration presses."""
    at_rest = FrameSpec((reference,), "srgb") if reference else None
    best = survey_radius([FrameSpec((image,), "srgb", at_rest=at_rest) for image in images], at_rest)
    return best is not None and best.presses >= ENOUGH * best.looked_at


def _flat_field(frames: Sequence[FrameSpec], reference: FrameSpec | None) -> Float32Array | None:
    """Return what frames are divided by; None where no frame can be read."""
    if reference is not None:
        return flat_field_of((), _three_lights(read_frame(reference)))
    readable = [frame for spec in frames if (frame := _readable(spec)) is not None]
    same = [frame for frame in readable if frame.shape == readable[0].shape]
    return flat_field_of(same, None) if same else None


def _readable(spec: FrameSpec) -> LinearFrame | None:
    try:
        return _three_lights(read_frame(spec))
    except FrameSetError:
        return None


def _three_lights(frame: LinearFrame) -> LinearFrame:
    """The frame; of more than three lights, three that are spread over them: balls show in any three."""
    lights = frame.rgb.shape[-1]
    if lights <= 3:
        return frame
    spread = np.ascontiguousarray(frame.rgb[..., [0, lights // 3, 2 * lights // 3]])
    return LinearFrame(spread, frame.clipped)


def _seen(press: PressFrame, flat_field: Float32Array | None) -> SeenPress:
    """The balls of a frame; what keeps any from being found is its fault."""
    frame, nothing = press.frame, BallSearch((), ())
    if frame.rgb.shape[-1] < 3:
        return SeenPress(frame, nothing, "fewer than three lights do not distinguish a ball from a shadow")
    if flat_field is None or flat_field.shape != frame.rgb.shape:
        return SeenPress(frame, nothing, "its size is not that of the reference")
    try:
        used = locate_usable(press, flat_field)
    except DeviceError as error:
        return SeenPress(frame, nothing, str(error).removeprefix(f"{press.label}: "))
    seen = used.seen or nothing
    return SeenPress(frame, seen if press.balls else BallSearch(used.balls, used.rejected), used.error)
