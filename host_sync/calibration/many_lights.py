"""The calibration of frames of any number of lights: one of three channels for each group of lights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from device.balls.sphere import Ball
from device.errors import CalibrationError
from device.imaging.flat_field import LinearFrame, flat_field_correct
from device.surface.fields import Float32Array
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import Calibration, calibrate, identified
from host_sync.light.model import Position
from host_sync.lights.light_groups import CHANNELS, Group, choose_groups, find_light_groups, in_group
from host_sync.uncertainty.joined_error import JoinedMaps, joined_slope_error


def calibrate_lights(
    presses: Sequence[PressFrame],
    reference: LinearFrame | None,
    pitch_um: float,
    *,
    others: Sequence[LinearFrame] = (),
    light_names: Sequence[str] = (),
    tell: Callable[[str], None] = lambda _: None,
    paper: bool = False,
    lights_mm: Sequence[Position] = (),
    pupil_height_mm: float | None = None,
) -> Calibration:
    """Return the calibration of frames of three to eight lights; arguments and errors as of `calibrate`, which does
    three.

    light_names : of the lights, for messages; numbers where there are none
    """
    frames = [press.frame for press in presses]
    shown = {frame.rgb.shape[2] for frame in [*frames, *others, *([reference] if reference else [])]}
    if len(shown) > 1:
        raise CalibrationError("frames show different numbers of lights: name the same lights in every frame")
    (count,) = shown or {CHANNELS}
    if count < CHANNELS:
        raise CalibrationError(f"frames show too few lights ({count}) to tell two slopes: give frames of three or more")
    if count == CHANNELS:
        return calibrate(
            presses,
            reference,
            pitch_um,
            others=others,
            tell=tell,
            paper=paper,
            lights_mm=lights_mm,
            pupil_height_mm=pupil_height_mm,
        )
    groups = choose_groups(frames)
    found = []
    for number, group in enumerate(groups, start=1):
        found.append(
            calibrate(
                [replace(press, frame=in_group(press.frame, group)) for press in presses],
                in_group(reference, group) if reference else None,
                pitch_um,
                others=[in_group(frame, group) for frame in others],
                tell=_telling(tell, f"lights {number} of {len(groups)}: "),
                lights_mm=[lights_mm[light] for light in group] if lights_mm else (),
                pupil_height_mm=pupil_height_mm,
            )
        )
    first = found[0]
    flat_field = _flat_field(groups, found, count)
    balls: list[tuple[Ball, ...]] = [press.balls for press in first.presses]
    lights = find_light_groups(groups, list(zip(frames, balls, strict=True)), flat_field, light_names)
    tell("measuring the slope error of all lights")
    images = [
        [flat_field_correct(in_group(frame, group), own.flat_field) for group, own in zip(groups, found, strict=True)]
        for frame in frames
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


def _telling(tell: Callable[[str], None], words: str) -> Callable[[str], None]:
    return lambda step: tell(words + step)
