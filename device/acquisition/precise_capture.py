"""Precise capture: several frames of one press averaged, and frames under no light and under each light alone.

A pixel's noise falls with the root of the number of frames. The sum keeps fractions of a count: its counts, black and
white level are multiples of a single frame's. A pixel that is saturated in any frame stays so.
"""

from __future__ import annotations

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
from device.acquisition.movie import Movie, Watch, record_movie
from device.bundles.movie import MAX_MOVIE_FRAMES
from device.bundles.scan import CaptureMode, ExposuresRecord, VerdictRecord
from device.errors import CaptureModeRefused
from device.guidance.downsample import downsample_step
from device.guidance.guide import PressMeasure, box_smoothed, change
from device.imaging.ambient import ambient_fraction
from device.imaging.flat_field import SATURATED, bin_bayer
from device.imaging.mosaic_binning import can_bin
from device.surface.fields import Float32Array
from hal.frame import RawFrame
from hal.hardware import Hardware

AVERAGE_S: Final = 0.150
"""Frames that are complete this long after the first one's exposure began are averaged."""

MAX_CHANGE: Final = 0.008
"""Change of smoothed light, 99th percentile relative to the brightest, from which a frame has moved: an edge that is
shifted by a pixel. Still frames of the twin change by 0.003 to 0.007."""

MAX_FRAMES: Final = 1000

_MAX_COUNT: Final = np.iinfo(np.uint16).max


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
    """What the raw frame is made of, and the names of the frames beside it."""
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
    """Why presses cannot be taken in this mode with this hardware; empty if they can."""
    if mode == "lights" and hardware.profile.lights_always_on:
        return "the lights of this sensor are always on, so that no light can be seen alone: use single or average"
    if mode == "movie" and not can_bin(hardware.camera.shape):
        return "a movie needs a frame of 4x4 blocks: use single or average"
    return ""


def capture_precisely(
    hardware: Hardware, plan: CaptureSettings, mode: CaptureMode, watch: Watch | None = None
) -> PreciseCapture:
    """One press by this mode; the lights are off again afterwards. Errors as for `capture_with_faults`.

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
        return PreciseCapture(best, movie=movie)
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
    below = _small(dark)
    seen = _small(lit) - below
    lights = np.stack([(_small(frame) - below).ravel() for frame in alone.values()], axis=-1)
    gains, *_ = np.linalg.lstsq(lights, seen.ravel(), rcond=None)
    brightest = _brightest(seen)
    return change(seen / brightest, (lights @ gains).reshape(seen.shape) / brightest)


def _averaged(hardware: Hardware, plan: CaptureSettings) -> PreciseCapture:
    """The average of the confirmed frames that are complete within `AVERAGE_S`."""
    first = capture_with_faults(hardware, plan, keep_lit=True)
    camera, step_us = hardware.camera, hardware.profile.sensor.exposure_step_us
    until_ns = first.frame.sensor_timestamp_ns + round(AVERAGE_S * 1e9)
    try:
        mean, still, moved = FrameMean(first.frame), _smooth(first.frame), 0
        while mean.frames < MAX_FRAMES:
            frame = camera.next_frame(FRAME_TIMEOUT_S)
            check_frame(frame, hardware.profile.sensor, camera.camera_id, plan.bayer_order)
            if hardware.clock.monotonic_ns() > until_ns or not plan.matches(frame.granted, step_us):
                break
            if change(still, _smooth(frame)) > MAX_CHANGE:
                moved += 1
            else:
                mean.add(frame)
    finally:
        hardware.lights.off()
    return PreciseCapture(Capture(mean.frame(), first.light_faults), mean.frames, moved)


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
        """The mean; with one frame that frame itself."""
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


def _smooth(frame: RawFrame) -> Float32Array:
    """A small smoothed image of a frame, relative to its brightest parts: float32 array of shape (h, w, 3)."""
    smooth = _small(frame)
    return smooth / _brightest(smooth)


def _small(frame: RawFrame) -> Float32Array:
    """A small smoothed image of a frame, fractions of full scale: float32 array of shape (h, w, 3)."""
    return box_smoothed(bin_bayer(frame, downsample_step(frame.shape)).rgb)


def _brightest(smooth: Float32Array) -> np.float32:
    return np.float32(max(float(np.percentile(smooth, 99)), 1e-6))


def with_ambient_share(verdict: VerdictRecord, precise: PreciseCapture) -> VerdictRecord:
    """The verdict with the measured ambient light among its figures."""
    if precise.dark is None:
        return verdict
    figures = verdict.figures | {"ambient_share": ambient_fraction(precise.dark)}
    return VerdictRecord(level=verdict.level, reason=verdict.reason, figures=figures)
