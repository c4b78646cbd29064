"""The frames that a calibration is made from, wherever they came from; whole, or with one ball kept out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from device.balls.sphere import Ball
from device.errors import CalibrationError
from device.imaging.flat_field import LinearFrame, NormalizedImage, flat_field_correct
from device.imaging.printed_marks import MarkPattern
from device.inverse_map.model import InverseMap
from device.surface import Float32Array, Float64Array
from host_sync.calibration.assessment import DIAMETER, DIAMETER_QUESTION, PIXEL_SHAPE
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import Calibration, calibrate, identified
from host_sync.calibration.scale import with_stated_pitch
from host_sync.kernels.process_settings import kept_memory
from host_sync.light.model import Position
from host_sync.light_groups import CHANNELS, Group, choose_groups, find_light_groups, in_group
from host_sync.uncertainty.slope_error import SlopeError, error_by_tilt


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFrames:
    """Frames of presses, the reference if there is one, and the pixel pitch (µm).

    others : frames that help to stand in for a missing reference
    light_names : of the lights, where they are said
    paper : whether the paper's model is fitted in any case
    lights_mm : place of the light of each channel, as of `Position`; empty where it is not known
    pupil_height_mm : the camera's height over untouched skin, as of `Viewpoint`; None where it is not known
    states_pixel_shape : the shape of pixels was stated, so that a disagreement is a note only
    states_diameters : balls were given by their diameters, so that no radius can be one
    pitch_tolerance : fraction by which the pixel pitch may be off; None where that is not known
    marks : printed on the skin, and taken out of the frames; None where there are none
    left_out : sentences about presses that cannot be used and are not among these
    """

    presses: tuple[PressFrame, ...]
    reference: LinearFrame | None
    pixel_pitch_um: float
    others: tuple[LinearFrame, ...] = ()
    light_names: tuple[str, ...] = ()
    paper: bool = False
    lights_mm: tuple[Position, ...] = ()
    pupil_height_mm: float | None = None
    states_pixel_shape: bool = False
    states_diameters: bool = False
    pitch_tolerance: float | None = None
    marks: MarkPattern | None = None
    left_out: tuple[str, ...] = ()

    def without(self, calibration: Calibration, press: int, held: Ball) -> CalibrationFrames:
        """Return the frames without one ball.

        calibration : made from all of the frames; states the other balls
        held : ball of the press number `press` that is left out
        """
        presses = []
        for number, (frame, used) in enumerate(zip(self.presses, calibration.presses, strict=True)):
            balls = tuple(
                replace(ball, viewpoint=None, apex_px=0.0)
                for ball in used.balls
                if not (number == press and ball == held)
            )
            if balls:
                presses.append(replace(frame, balls=balls, labelled_by_hand=False))
        return replace(self, presses=tuple(presses))


@kept_memory()
def calibrate_frames(frames: CalibrationFrames, report_progress: Callable[[str], None] = lambda _: None) -> Calibration:
    """Return the calibration that the frames carry; errors as for `calibrate`."""
    calibration = calibrate_lights(frames, report_progress)
    assessment = calibration.assessment
    added = frames.left_out if frames.marks is None else (*frames.left_out, frames.marks.note)
    if added:
        assessment = replace(assessment, notes=(*assessment.notes, *added))
    if frames.states_pixel_shape:
        left = tuple(check for check in assessment.checks if check.name != PIXEL_SHAPE)
        shape, notes = assessment.pixel_shape, assessment.notes
        if shape is not None:
            asked = shape.disagreement(calibration.pitch_um)
            notes = tuple(shape.against_stated if note == asked else note for note in notes)
        assessment = replace(assessment, checks=left, notes=notes)
    if frames.states_diameters:
        left = tuple(check for check in assessment.checks if check.name != DIAMETER)
        notes = tuple(note for note in assessment.notes if DIAMETER_QUESTION not in note)
        assessment = replace(assessment, checks=left, notes=notes)
    if frames.pitch_tolerance is not None:
        scale = with_stated_pitch(assessment.scale, calibration.pitch_um, frames.pitch_tolerance)
        assessment = replace(assessment, scale=scale)
    if assessment is calibration.assessment:
        return calibration
    return identified(replace(calibration, assessment=assessment))


# The calibration of frames of any number of lights: one of three channels for each group of lights.


def calibrate_lights(frames: CalibrationFrames, report_progress: Callable[[str], None] = lambda _: None) -> Calibration:
    """Return the calibration of frames of three to eight lights; errors as for `calibrate`, which takes three."""
    pressed = [press.frame for press in frames.presses]
    references = [frames.reference] if frames.reference else []
    shown = {frame.rgb.shape[2] for frame in (*pressed, *frames.others, *references)}
    if len(shown) > 1:
        raise CalibrationError("frames show different numbers of lights: name the same lights in every frame")
    (count,) = shown or {CHANNELS}
    if count < CHANNELS:
        raise CalibrationError(f"frames show too few lights ({count}) for two slopes: give frames of three or more")
    if count == CHANNELS:
        return calibrate(
            frames.presses,
            frames.reference,
            frames.pixel_pitch_um,
            others=frames.others,
            report_progress=report_progress,
            paper=frames.paper,
            lights_mm=frames.lights_mm,
            pupil_height_mm=frames.pupil_height_mm,
        )
    groups = choose_groups(pressed)
    found = []
    for number, group in enumerate(groups, start=1):
        part = replace(
            frames,
            presses=tuple(replace(press, frame=in_group(press.frame, group)) for press in frames.presses),
            reference=in_group(frames.reference, group) if frames.reference else None,
            others=tuple(in_group(frame, group) for frame in frames.others),
            paper=False,
            lights_mm=tuple(frames.lights_mm[light] for light in group) if frames.lights_mm else (),
        )
        found.append(calibrate_lights(part, _with_prefix(report_progress, f"lights {number} of {len(groups)}: ")))
    first = found[0]
    flat_field = _flat_field(groups, found, count)
    balls: list[tuple[Ball, ...]] = [press.balls for press in first.presses]
    lights = find_light_groups(groups, list(zip(pressed, balls, strict=True)), flat_field, frames.light_names)
    report_progress("measuring the slope error of all lights")
    images = [
        [flat_field_correct(in_group(frame, group), own.flat_field) for group, own in zip(groups, found, strict=True)]
        for frame in pressed
    ]
    maps = JoinedMaps(tuple(own.inverse.map for own in found))
    error = joined_slope_error(first.slope_error, images, balls, maps)
    return identified(replace(first, lights=lights, beside=tuple(found[1:]), slope_error=error))


def _flat_field(groups: Sequence[Group], found: Sequence[Calibration], count: int) -> Float32Array:
    """Return the light of untouched skin of every light, (H, W, N)."""
    flat_field = np.empty((*found[0].flat_field.shape[:2], count), np.float32)
    for group, calibration in zip(groups, found, strict=True):
        flat_field[..., list(group)] = calibration.flat_field
    return flat_field


def _with_prefix(report_progress: Callable[[str], None], words: str) -> Callable[[str], None]:
    return lambda step: report_progress(words + step)


# Slope error of several groups of lights read together.
#
# It is that of the first group and what joining them changes. Both are measured on the same balls with the same maps;
# what the first group's error holds besides, held-out inflation and elevation, stays.

MIN_ERROR_RATIO: Final = 0.3
"""Joining groups is not trusted to lessen an error by more."""


@dataclass(frozen=True, slots=True)
class JoinedMaps:
    """The mean of several inverse maps, each of which reads three channels of its own."""

    maps: tuple[InverseMap, ...]

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Return slopes p and q, float64 array of shape (N, 2), of intensities of shape (N, 3 times the groups)."""
        parts = [
            one.predict(np.ascontiguousarray(intensity[:, CHANNELS * i : CHANNELS * (i + 1)]), column, row)
            for i, one in enumerate(self.maps)
        ]
        return np.asarray(np.mean(parts, axis=0), np.float64)


def joined_slope_error(
    first: SlopeError, images: Sequence[Sequence[NormalizedImage]], balls: Sequence[Sequence[Ball]], maps: JoinedMaps
) -> SlopeError:
    """Return the slope error of the groups' mean.

    first : of the first group
    images : of every press, its intensity by group
    balls : of every press
    """
    together = [(_beside(groups), own) for groups, own in zip(images, balls, strict=True)]
    alone = error_by_tilt([(image, own) for image, own in together], JoinedMaps(maps.maps[:1]))
    joined = error_by_tilt(together, maps)
    shares = [
        np.clip(
            np.interp(first.tilt_deg, joined.tilt_deg, after)
            / np.maximum(np.interp(first.tilt_deg, alone.tilt_deg, before), 1e-9),
            MIN_ERROR_RATIO,
            None,
        )
        for before, after in ((alone.pixel_deg, joined.pixel_deg), (alone.patch_deg, joined.patch_deg))
    ]
    return msgspec.structs.replace(
        first,
        pixel_deg=tuple(float(value) for value in shares[0] * first.pixel_deg),
        patch_deg=tuple(float(value) for value in shares[1] * first.patch_deg),
    )


def _beside(groups: Sequence[NormalizedImage]) -> NormalizedImage:
    """Return the intensities of all groups side by side: valid where all are, clipped where one is."""
    return NormalizedImage(
        np.concatenate([image.values for image in groups], axis=-1),
        np.logical_and.reduce([image.valid for image in groups]),
        np.logical_or.reduce([image.clipped for image in groups]),
    )
