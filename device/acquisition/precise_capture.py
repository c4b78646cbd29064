"""One press as several frames: a movie from touch to depth, a mean, or one under each light and under none.

A movie holds raw frames of half the size, and the best at full size.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.acquisition.capture import (
    FRAME_TIMEOUT_S,
    Capture,
    CaptureSettings,
    capture,
    capture_with_faults,
    check_frame,
    retry_with_restart,
)
from device.bundles.scan import (
    MAX_MOVIE_FRAMES,
    CaptureMode,
    ExposuresRecord,
    MovieFrameRecord,
    MovieRecord,
    VerdictRecord,
)
from device.errors import CaptureModeRefused
from device.guidance.guide import PressMeasure, box_smoothed, change, downsample_bayer, downsample_step
from device.imaging.flat_field import MOVIE_BINNING, SATURATED, bin_bayer, bin_mosaic, can_bin
from device.imaging.frame_light import ambient_fraction
from device.surface import Float32Array
from hal.frame import RawFrame
from hal.hardware import Hardware

MOVIE_S: Final = 5.0
"""A movie is so long where memory and disk have room."""

MEMORY_FRACTION: Final = 0.25
"""Of the free memory that a movie may fill before it is written."""

STILL: Final = 0.008
"""Change of smoothed light from one frame to the next at which a frame counts half: an edge that moves by a pixel."""

Watch = Callable[[RawFrame], PressMeasure]


@dataclass(frozen=True, slots=True, eq=False)
class Movie:
    """Frames of half the size, and what was seen in each.

    frames : in order of time
    measures : contact and depth in each
    best : number of the first frame in the mean that is stored at full size
    averaged : frames in that mean
    """

    frames: tuple[RawFrame, ...]
    measures: tuple[PressMeasure, ...]
    best: int
    averaged: int

    @property
    def moved(self) -> int:
        """Frames after the best that were left out of the mean because the object had moved."""
        return len(self.frames) - self.best - self.averaged

    def record(self) -> MovieRecord:
        """Return what the bundle says of it."""
        began_ns = self.frames[0].sensor_timestamp_ns
        return MovieRecord(
            binning=MOVIE_BINNING,
            best=self.best,
            frames=tuple(
                MovieFrameRecord(
                    file=f"movie-{number:04d}.tif",
                    at_ms=max((frame.sensor_timestamp_ns - began_ns) / 1e6, 0.0),
                    contact_fraction=seen.contact_fraction,
                    depth_um=seen.depth_um,
                )
                for number, (frame, seen) in enumerate(zip(self.frames, self.measures, strict=True))
            ),
        )


def frames_that_fit(shape: tuple[int, int]) -> int:
    """Return frames of a movie of full-size frames (H, W) that memory has room for, one at least."""
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    each = 2 * shape[0] * shape[1] // MOVIE_BINNING**2
    return max(1, min(MAX_MOVIE_FRAMES, int(MEMORY_FRACTION * free) // each))


def record_movie(hardware: Hardware, plan: CaptureSettings, watch: Watch) -> tuple[Capture, Movie]:
    """Return frames for `MOVIE_S`, or as many as fit in memory; the lights are off again afterwards.

    The best frame is the one with most contact, less the more it differs from the one before it. The capture is the
    mean of it and of all later frames that did not move against it. Errors as for `capture_with_faults`.

    watch : what the guide measures in a frame
    """
    first = capture_with_faults(hardware, plan, keep_lit=True)
    camera, step_us = hardware.camera, hardware.profile.sensor.exposure_step_us
    until_ns = first.frame.sensor_timestamp_ns + round(MOVIE_S * 1e9)
    most = frames_that_fit(first.frame.shape)
    frames, measures = [bin_mosaic(first.frame)], [watch(first.frame)]
    best, best_score, before = 0, 0.0, _small(first.frame)
    mean, still = FrameMean(first.frame), smoothed(first.frame)
    try:
        while len(frames) < most:
            frame = camera.next_frame(FRAME_TIMEOUT_S)
            check_frame(frame, hardware.profile.sensor, camera.camera_id, plan.bayer_order)
            if hardware.clock.monotonic_ns() > until_ns or not plan.matches(frame.granted, step_us):
                break
            seen, now = watch(frame), _small(frame)
            score = (seen.contact_fraction or 0.0) / (1.0 + change(before, now) / STILL)
            smooth = smoothed(frame)
            if change(still, smooth) <= MAX_CHANGE:
                mean.add(frame)
            elif score > best_score:
                best, mean, still = len(frames), FrameMean(frame), smooth
            best_score = max(best_score, score)
            frames.append(bin_mosaic(frame))
            measures.append(seen)
            before = now
    finally:
        hardware.lights.off()
    return Capture(mean.frame(), first.light_faults), Movie(tuple(frames), tuple(measures), best, mean.frames)


def _small(frame: RawFrame) -> Float32Array:
    return box_smoothed(downsample_bayer(frame).rgb)


# The mean of frames of one press that did not move.
#
# A pixel's noise falls with the root of the number of frames. The sum keeps fractions of a count: its counts, black and
# white level are multiples of a single frame's. A pixel that is saturated in any frame stays so.

MAX_CHANGE: Final = 0.008
"""Change of smoothed light, 99th percentile relative to the brightest, from which a frame has moved: an edge that is
shifted by a pixel. Still frames of the twin change by 0.003 to 0.007."""

MAX_FRAMES: Final = 1000

_MAX_COUNT: Final = np.iinfo(np.uint16).max


class FrameMean:
    """The mean of raw frames of equal settings, without rounding to whole counts.

    frames : summed so far, at most `MAX_FRAMES`
    """

    def __init__(self, first: RawFrame) -> None:
        self._first = first
        self._sum: NDArray[np.uint32] = first.mosaic.astype(np.uint32)
        self._brightest = first.mosaic.copy()
        self.frames = 1

    def add(self, frame: RawFrame) -> None:
        """Add a frame."""
        self._sum += frame.mosaic
        np.maximum(self._brightest, frame.mosaic, out=self._brightest)
        self.frames += 1

    def frame(self) -> RawFrame:
        """Return the mean; with one frame that frame itself."""
        first = self._first
        if self.frames == 1:
            return first
        scale = max(int(_MAX_COUNT // first.white_level_dn), 1)
        limit = first.black_level_dn + SATURATED * (first.white_level_dn - first.black_level_dn)
        mosaic = np.empty_like(first.mosaic)
        for row, (total, brightest) in enumerate(zip(self._sum, self._brightest, strict=True)):
            mean = (total * np.uint32(scale) + np.uint32(self.frames // 2)) // np.uint32(self.frames)
            saturated = brightest.astype(np.uint32) * np.uint32(scale)
            mosaic[row] = np.minimum(np.where(brightest >= limit, saturated, mean), _MAX_COUNT)
        return replace(
            first,
            mosaic=mosaic,
            black_level_dn=first.black_level_dn * scale,
            white_level_dn=first.white_level_dn * scale,
        )


def smoothed(frame: RawFrame) -> Float32Array:
    """Return a small smoothed image of a frame, relative to its brightest parts: float32 array of shape (h, w, 3)."""
    smooth = small_light(frame)
    return smooth / brightest_light(smooth)


def small_light(frame: RawFrame) -> Float32Array:
    """Return a small smoothed image of a frame, fractions of full scale: float32 array of shape (h, w, 3)."""
    return box_smoothed(bin_bayer(frame, downsample_step(frame.shape)).rgb)


def brightest_light(smooth: Float32Array) -> np.float32:
    """Return the 99th percentile of a small image, above zero."""
    return np.float32(max(float(np.percentile(smooth, 99)), 1e-6))


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
