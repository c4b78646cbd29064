"""Precise capture: several frames of one press averaged, and frames under no light and under each light alone."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from device.acquisition.capture import (
    FRAME_TIMEOUT_S,
    Capture,
    CaptureSettings,
    capture,
    capture_with_faults,
    check_frame,
    retry_with_restart,
)
from device.acquisition.movie import (
    MAX_CHANGE,
    MAX_FRAMES,
    FrameMean,
    Movie,
    Watch,
    brightest_light,
    record_movie,
    small_light,
    smoothed,
)
from device.bundles.scan import MAX_MOVIE_FRAMES, Annotations, CaptureMode, ExposuresRecord, VerdictLevel, VerdictRecord
from device.errors import CaptureModeRefused
from device.guidance.guide import PressMeasure, change
from device.imaging.flat_field import can_bin
from device.imaging.frame_light import ambient_fraction
from hal.frame import RawFrame
from hal.hardware import Hardware


@dataclass(frozen=True, slots=True)
class Retake:
    """The scan that a press is to replace, as it was when the operator asked for that."""

    scan_id: str
    counter: int
    level: VerdictLevel
    annotations: Annotations

    def is_replaced_by(self, level: VerdictLevel) -> bool:
        """Return whether a press with this verdict replaces it: not one that is worse, or to be taken again itself."""
        return level != "retake" and not (level == "doubtful" and self.level == "good")


AVERAGE_S: Final = 0.150
"""Frames that are complete this long after the first one's exposure began are averaged."""


@dataclass(frozen=True, slots=True, eq=False)
class PreciseCapture:
    """One press.

    capture : its frame, averaged if there were several
    averaged : frames in it
    moved : frames that were left out because the object had moved
    dark : the frame under no light; None if not taken
    alone : the frame under each light alone, by its name; empty where the object moved meanwhile
    alone_moved : frames that were left out for that
    movie : frames of the whole press; None if not taken
    """

    capture: Capture
    averaged: int = 1
    moved: int = 0
    dark: RawFrame | None = None
    alone: dict[str, RawFrame] = field(default_factory=dict)
    alone_moved: int = 0
    movie: Movie | None = None


def exposures_record(precise: PreciseCapture) -> ExposuresRecord:
    """Return what the raw frame is made of, and the names of the frames beside it."""
    return ExposuresRecord(
        averaged=precise.averaged,
        moved=precise.moved,
        dark_file=None if precise.dark is None else "dark.tif",
        alone_files={name: f"alone-{number}.tif" for number, name in enumerate(precise.alone)},
        alone_moved=precise.alone_moved,
    )


def frames_stored(mode: CaptureMode, lights: int) -> int:
    """Raw frames that a scan stores at most; frames of a movie count for a quarter."""
    if mode == "movie":
        return 1 + MAX_MOVIE_FRAMES // 4
    return 2 + lights if mode == "lights" else 1


def mode_fault(mode: CaptureMode, hardware: Hardware) -> str:
    """Return why presses cannot be taken in this mode with this hardware; empty if they can."""
    if mode == "lights" and hardware.profile.lights_always_on:
        return "the lights of this sensor are always on, so that no light can be seen alone: use single or average"
    if mode == "movie" and not can_bin(hardware.camera.shape):
        return "a movie needs a frame of 4x4 blocks: use single or average"
    return ""


def capture_precisely(
    hardware: Hardware, plan: CaptureSettings, mode: CaptureMode, watch: Watch | None = None
) -> PreciseCapture:
    """Return one press by this mode; the lights are off again afterwards. Errors as for `capture_with_faults`.

    watch : what the guide measures in a frame of a movie; None: nothing

    Raises
    ------
    CaptureModeRefused
        The hardware cannot take presses in this mode.
    """
    if sentence := mode_fault(mode, hardware):
        raise CaptureModeRefused(sentence)
    if mode == "single":
        return PreciseCapture(capture_with_faults(hardware, plan))
    if mode == "movie":
        best, movie = record_movie(hardware, plan, watch or _nothing)
        return PreciseCapture(best, movie.averaged, movie.moved, movie=movie)
    found = retry_with_restart(hardware.camera, lambda: _averaged(hardware, plan))
    if mode == "average":
        return found
    under = {name: replace(plan, currents_ma={name: plan.currents_ma[name]}) for name in hardware.lights.names}
    alone = {name: capture(hardware, only) for name, only in under.items()}
    dark = capture(hardware, replace(plan, currents_ma={}))
    if _together(alone, dark, found.capture.frame) > MAX_CHANGE:
        return replace(found, dark=dark, alone_moved=len(alone))
    return replace(found, dark=dark, alone=alone)


def _nothing(_frame: RawFrame) -> PressMeasure:
    return PressMeasure()


def _together(alone: dict[str, RawFrame], dark: RawFrame, lit: RawFrame) -> float:
    """Change from the light of all lights to the sum of each light's own, as 99th percentile.

    Light adds up, so only movement changes the sum; a light that is a little weaker beside others on one supply is
    fitted. Which frame moved is not seen: one light's frame does not show what the others light.
    """
    below = small_light(dark)
    seen = small_light(lit) - below
    lights = np.stack([(small_light(frame) - below).ravel() for frame in alone.values()], axis=-1)
    gains, *_ = np.linalg.lstsq(lights, seen.ravel(), rcond=None)
    brightest = brightest_light(seen)
    return change(seen / brightest, (lights @ gains).reshape(seen.shape) / brightest)


def _averaged(hardware: Hardware, plan: CaptureSettings) -> PreciseCapture:
    """Return the average of the confirmed frames that are complete within `AVERAGE_S`."""
    first = capture_with_faults(hardware, plan, keep_lit=True)
    camera, step_us = hardware.camera, hardware.profile.sensor.exposure_step_us
    until_ns = first.frame.sensor_timestamp_ns + round(AVERAGE_S * 1e9)
    try:
        mean, still, moved = FrameMean(first.frame), smoothed(first.frame), 0
        while mean.frames < MAX_FRAMES:
            frame = camera.next_frame(FRAME_TIMEOUT_S)
            check_frame(frame, hardware.profile.sensor, camera.camera_id, plan.bayer_order)
            if hardware.clock.monotonic_ns() > until_ns or not plan.matches(frame.granted, step_us):
                break
            if change(still, smoothed(frame)) > MAX_CHANGE:
                moved += 1
            else:
                mean.add(frame)
    finally:
        hardware.lights.off()
    return PreciseCapture(Capture(mean.frame(), first.light_faults), mean.frames, moved)


def with_ambient_share(verdict: VerdictRecord, precise: PreciseCapture) -> VerdictRecord:
    """Return the verdict with the measured ambient light among its figures."""
    if precise.dark is None:
        return verdict
    figures = verdict.figures | {"ambient_share": ambient_fraction(precise.dark)}
    return VerdictRecord(level=verdict.level, reason=verdict.reason, figures=figures)
