"""A frame set: images from another camera, described by a `frameset.toml`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from device.balls.sphere import Ball
from hal.frame import RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.channels import check_channels, count_values, full_scale_of
from host_sync.frames.frame_set_file import (
    Encoding,
    FileTable,
    ImageNames,
    PressTable,
    image_path,
    read_frame_set_file,
    set_file,
)
from host_sync.frames.image_file import read_image, read_info
from host_sync.frames.image_info import ImageInfo, check_one_orientation, square_pitch, square_place, square_shape

COUNTED_SCANS: Final = 8
"""At most so many scans show, beside reference and presses, where counts of 16 bit end."""


@dataclass(frozen=True, slots=True)
class FrameSpec:
    """One frame: an RGB image, or a grey one a light (three in R, G, B order), and how their values encode light.

    full_scale : count at which a pixel of 16 bit is saturated; None for the largest
    pixel_shape : height of a stored pixel over its width
    at_rest : the set's frame of untouched skin, whose printed marks are taken out of this one; None where it has none
    marks_px : width of printed marks that are taken out where the set has no frame of untouched skin; 0 for none
    """

    images: tuple[Path, ...]
    encoding: Encoding
    full_scale: int | None = None
    pixel_shape: float = 1.0
    at_rest: FrameSpec | None = None
    marks_px: float = 0.0

    @property
    def name(self) -> str:
        """Path of the first image, for messages: without the steps back that a frame set in another folder needs."""
        first = self.images[0]
        return str(first.resolve() if ".." in first.parts else first)


@dataclass(frozen=True, slots=True)
class PressSpec:
    """A calibration press.

    name : "press-00" and so on, in the order of the file
    balls : labelled balls in pixels, or None to detect them
    radius_tolerance_mm : tolerance of the ball radius, None when not stated
    grid_pitch_mm, grid_tolerance_mm : distance of neighbouring balls when they form a square grid, and its tolerance
    """

    name: str
    frame: FrameSpec
    ball_radius_mm: float
    radius_px: float
    balls: tuple[Ball, ...] | None
    grid_pitch_mm: float | None
    radius_tolerance_mm: float | None = None
    grid_tolerance_mm: float | None = None


@dataclass(frozen=True, slots=True)
class ScanSpec:
    """A frame to reconstruct; its name is valid for a folder."""

    name: str
    frame: FrameSpec


@dataclass(frozen=True, slots=True)
class FrameSet:
    """A checked frame set; every frame has the same (H, W) `shape` and as many lights.

    pixel_pitch_um, shape : of square pixels, which frames are brought to when they are read
    pixel_shape : height of a stored pixel over its width
    full_scale : count at which a pixel of 16 bit is saturated; None where no frame has 16 bit
    states_full_scale : it stands in the file, or in an image's header
    states_pixel_shape : two pitches stand in the file
    states_diameters : every ball is given by its diameter
    pitch_tolerance : fraction by which the pixel pitch may be off; None where the file does not say
    lights : their names with their colours, empty where the file does not say
    lights_mm : where each stands, right, down and up from the middle of the field; empty where the file does not say
    pupil_height_mm : the camera's height over untouched skin; None where the file does not say
    """

    path: Path
    name: str
    pixel_pitch_um: float
    shape: tuple[int, int]
    reference: FrameSpec | None
    presses: tuple[PressSpec, ...]
    scans: tuple[ScanSpec, ...]
    lights: tuple[str, ...] = ()
    lights_mm: tuple[tuple[float, float, float], ...] = ()
    pupil_height_mm: float | None = None
    pixel_shape: float = 1.0
    full_scale: int | None = None
    states_full_scale: bool = False
    pitch_tolerance: float | None = None
    states_pixel_shape: bool = False
    states_diameters: bool = False

    def scaled_as(self, full_scale: int | None) -> FrameSet:
        """Return the set with scans of a full scale that another set's frames show, where this one states none.

        Raises
        ------
        FrameSetError
            The frames hold counts above it.
        """
        if None in (self.full_scale, full_scale) or self.states_full_scale or self.full_scale == full_scale:
            return self
        if (self.full_scale or 0) > (full_scale or 0):
            raise FrameSetError(
                f"{self.path}: its frames hold counts above {full_scale}, at which those of the calibration are "
                "saturated: use a calibration of this camera mode, or state full_scale"
            )
        scans = tuple(replace(scan, frame=replace(scan.frame, full_scale=full_scale)) for scan in self.scans)
        return replace(self, scans=scans, full_scale=full_scale)

    def with_marks(self, marks_px: float) -> FrameSet:
        """Return the set with scans without the printed marks that another set's frame of untouched skin shows."""
        if self.reference is not None or not marks_px:
            return self
        scans = tuple(replace(scan, frame=replace(scan.frame, marks_px=marks_px)) for scan in self.scans)
        return replace(self, scans=scans)


def load_frame_set(path: Path, *, calibrates: bool = True) -> FrameSet:
    """Read and check a frame set; of its images, only headers, the first press and, of 16 bit, counts are read.

    path : its file, or the folder that holds it
    calibrates : refuse a set without a calibration press

    Raises
    ------
    FrameSetError
        Names the file and the key, or the image, that is wrong.
    """
    path = set_file(path)
    file = read_frame_set_file(path, calibrates=calibrates)
    try:
        pitch_um, pixel_shape = square_pitch(file.pixel_pitch_um)
    except FrameSetError as error:
        raise FrameSetError(f"{path}: {error}") from error

    def frame(image: ImageNames) -> FrameSpec:
        names = (image,) if isinstance(image, str) else image
        return FrameSpec(
            tuple(image_path(path.parent, name) for name in names), file.encoding, file.full_scale, pixel_shape
        )

    reference = frame(file.reference.image) if file.reference else None
    press_frames = [frame(press.image) for press in file.press]
    scans = tuple(ScanSpec(scan.name, frame(scan.image)) for scan in file.scan)
    keyed = [("reference.image", reference)] if reference else []
    keyed += [(f"press[{i}].image", spec) for i, spec in enumerate(press_frames)]
    keyed += [(f"scan[{i}].image", scan.frame) for i, scan in enumerate(scans)]
    stored, channels, known = _common_form(keyed, path)
    full_scale, is_stated = _full_scale([spec for _, spec in keyed], len(scans), known, path, file.full_scale)
    if press_frames:
        _check_channels(press_frames[0], f"{path}: press[0].image")
    lights = _light_names(file, channels, path)
    if full_scale is not None:
        reference = reference and replace(reference, full_scale=full_scale)
        press_frames = [replace(spec, full_scale=full_scale) for spec in press_frames]
        scans = tuple(replace(scan, frame=replace(scan.frame, full_scale=full_scale)) for scan in scans)
    if reference is not None:
        reference, *press_frames = [replace(spec, at_rest=reference) for spec in (reference, *press_frames)]
        scans = tuple(replace(scan, frame=replace(scan.frame, at_rest=reference.at_rest)) for scan in scans)
    presses = tuple(_press(i, press, press_frames[i], stored, pitch_um, path) for i, press in enumerate(file.press))
    return FrameSet(
        path,
        file.name,
        pitch_um,
        square_shape(stored, pixel_shape),
        reference,
        presses,
        scans,
        lights,
        _light_places(file, path),
        file.pupil_height_mm,
        pixel_shape,
        full_scale,
        is_stated,
        _pitch_tolerance(file, pitch_um, path),
        isinstance(file.pixel_pitch_um, tuple),
        all(press.ball_diameter_mm is not None for press in file.press),
    )


def _check_channels(press: FrameSpec, name: str) -> None:
    """Refuse a press of which two channels are equal; those of a raw mosaic have sites of their own."""
    planes = [pixels for image in press.images if not isinstance(pixels := read_image(image), RawFrame)]
    if len(planes) > 1:
        check_channels(np.stack(planes, axis=-1), name, press.images)
    elif planes and planes[0].ndim == 3:
        check_channels(planes[0], f"{name}: {press.name}")


def _pitch_tolerance(file: FileTable, pitch_um: float, path: Path) -> float | None:
    """Return the tolerance of the pixel pitch as a fraction; FrameSetError where it is not smaller than the pitch."""
    tolerance_um = file.pixel_pitch_tolerance_um
    if tolerance_um is not None and tolerance_um >= pitch_um:
        raise FrameSetError(f"{path}: pixel_pitch_tolerance_um: {tolerance_um:g} is not smaller than the pitch")
    return None if tolerance_um is None else tolerance_um / pitch_um


def _full_scale(
    frames: Sequence[FrameSpec], scans: int, known: dict[Path, ImageInfo], path: Path, given: int | None
) -> tuple[int | None, bool]:
    """Return the count at which frames of 16 bit are saturated, and whether it is given or headers state it.

    scans : number of the last frames, which are scans
    """
    first_scan = len(frames) - scans
    counted = [*frames[:first_scan], *frames[first_scan :: max(1, scans // COUNTED_SCANS)]]
    images = [image for spec in counted for image in spec.images if known[image].bits == 16 and not known[image].is_raw]
    if not images:
        return given, given is not None
    stated = max((known[image].full_scale or 0 for image in images), default=0) or None
    histogram = count_values(read_image(image) for image in dict.fromkeys(images))
    try:
        found = full_scale_of(histogram, stated, frames[0].encoding, given)
    except FrameSetError as error:
        raise FrameSetError(f"{path}: {error}") from error
    return found, found in (given, stated)


def _common_form(
    frames: Sequence[tuple[str, FrameSpec]], path: Path
) -> tuple[tuple[int, int], int, dict[Path, ImageInfo]]:
    """(H, W) and channels of all frames, each an RGB image or grey ones of one size; and what every image is."""
    known: dict[Path, ImageInfo] = {}
    for key, spec in frames:
        for image in spec.images:
            known[image] = known.get(image) or _info(image, key, path)
    try:
        check_one_orientation(known)
    except FrameSetError as error:
        raise FrameSetError(f"{path}: {error}") from error
    first_key, shape = "", (0, 0)
    for key, spec in frames:
        for image in spec.images:
            info = known[image]
            if not shape[0]:
                first_key, shape = key, info.shape
            if info.shape != shape:
                raise FrameSetError(
                    f"{path}: {key}: {image} is {_size(info.shape)} pixels and {first_key} is {_size(shape)}: "
                    "use frames of one camera mode"
                )
            if len(spec.images) > 1 and info.channels == 3:
                raise FrameSetError(f"{path}: {key}: {image} is RGB: name it alone, or a grey image a light")
    counts = {spec: _channels(spec, known) for _, spec in frames}
    for key, spec in frames:
        if counts[spec] != counts[frames[0][1]]:
            raise FrameSetError(
                f"{path}: {key}: has {_channels_of(counts[spec])} and {first_key} {counts[frames[0][1]]}: "
                "name the same lights in every frame"
            )
    return shape, counts[frames[0][1]], known


def _channels_of(count: int) -> str:
    return "1 channel" if count == 1 else f"{count} channels"


def _channels(spec: FrameSpec, known: dict[Path, ImageInfo]) -> int:
    return len(spec.images) if len(spec.images) > 1 else known[spec.images[0]].channels


def _light_names(file: FileTable, channels: int, path: Path) -> tuple[str, ...]:
    """Return what the lights are called; FrameSetError where they are not as many as the channels of a frame."""
    names = tuple(f"{light.name} ({light.colour})" if light.colour else light.name for light in file.light)
    if names and len(names) != channels:
        raise FrameSetError(
            f"{path}: light: {len(names)} lights are described and a frame has {_channels_of(channels)}"
        )
    return names


def _light_places(file: FileTable, path: Path) -> tuple[tuple[float, float, float], ...]:
    """Return where the lights stand; FrameSetError where the file states it of some of them only."""
    known = tuple(light.position_mm for light in file.light if light.position_mm is not None)
    if known and len(known) != len(file.light):
        raise FrameSetError(f"{path}: light: position_mm is stated for {len(known)} of {len(file.light)} lights")
    return known


def _info(image: Path, key: str, path: Path) -> ImageInfo:
    try:
        return read_info(image)
    except FrameSetError as error:
        raise FrameSetError(f"{path}: {key}: {error}") from error


def check_ball(ball: Ball, shape: tuple[int, int], place: str) -> None:
    """Refuse a ball that does not lie in a frame of this shape, or a contact that is not smaller than its sphere.

    place : what names the ball in a message

    Raises
    ------
    FrameSetError
        Its centre is outside the frame, or its contact is as large as the sphere.
    """
    if not (0.0 <= ball.column <= shape[1] - 1 and 0.0 <= ball.row <= shape[0] - 1):
        raise FrameSetError(
            f"{place}: its centre ({ball.column:g}, {ball.row:g}) is outside the frame, {_size(shape)} pixels"
        )
    if not math.isfinite(ball.radius_px) or ball.contact_radius_px >= ball.radius_px:
        raise FrameSetError(
            f"{place}.r: a contact of {ball.contact_radius_px:g} px is not smaller than the ball, "
            f"{ball.radius_px:.1f} px: check ball_radius_mm and pixel_pitch_um"
        )


def square_ball(ball: Ball, shape: tuple[int, int], pixel_shape: float) -> Ball:
    """Return a labelled ball of a frame in square pixels; its contact does not grow.

    shape : (H, W) of the frame as it is stored
    """
    column, row = square_place(ball.column, ball.row, shape, pixel_shape)
    contact_px = ball.contact_radius_px * min(pixel_shape, 1.0 / pixel_shape)
    return replace(ball, column=column, row=row, contact_radius_px=contact_px)


def _press(
    number: int, press: PressTable, frame: FrameSpec, shape: tuple[int, int], pixel_pitch_um: float, path: Path
) -> PressSpec:
    """Return the press with lengths in square pixels, its balls checked against frame and sphere.

    shape : of the frame as it is stored, in whose pixels the file gives balls
    """
    radius_px = press.radius_mm * 1000.0 / pixel_pitch_um
    balls = None if press.balls is None else tuple(Ball(b.x, b.y, b.r, radius_px) for b in press.balls)
    balls = balls and tuple(square_ball(ball, shape, frame.pixel_shape) for ball in balls)
    for i, ball in enumerate(balls or ()):
        check_ball(ball, square_shape(shape, frame.pixel_shape), f"{path}: press[{number}].balls[{i}]")
    _check_tolerances(press, f"{path}: press[{number}]")
    return PressSpec(
        name=f"press-{number:02d}",
        frame=frame,
        ball_radius_mm=press.radius_mm,
        radius_px=radius_px,
        balls=balls,
        grid_pitch_mm=press.grid_pitch_mm,
        radius_tolerance_mm=press.ball_radius_tolerance_mm,
        grid_tolerance_mm=press.grid_pitch_tolerance_mm,
    )


def _check_tolerances(press: PressTable, key: str) -> None:
    """Refuse tolerances that are not smaller than their quantity, and a grid tolerance without a grid."""
    tolerance = press.ball_radius_tolerance_mm
    if tolerance is not None and tolerance >= press.radius_mm:
        raise FrameSetError(f"{key}.ball_radius_tolerance_mm: {tolerance:g} is not smaller than the radius")
    tolerance = press.grid_pitch_tolerance_mm
    if tolerance is not None and press.grid_pitch_mm is None:
        raise FrameSetError(f"{key}.grid_pitch_tolerance_mm: needs grid_pitch_mm")
    if tolerance is not None and press.grid_pitch_mm is not None and tolerance >= press.grid_pitch_mm:
        raise FrameSetError(f"{key}.grid_pitch_tolerance_mm: {tolerance:g} is not smaller than the spacing")


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]}x{shape[0]}"
