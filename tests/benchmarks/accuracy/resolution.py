"""Resolution: smallest retained amplitude of sinusoids and widest ridge, with and without mosaic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from device.imaging.flat_field import demosaic
from device.surface import HeightMap
from hal.board_profile import BoardProfile
from host_sync.calibration.calibrate import Method
from host_sync.calibration_file.calibrator import calibrate_frame_set
from host_sync.frames.linear_light import read_frame
from host_sync.reconstruction.pipeline import reconstruct
from tests.benchmarks.accuracy.pattern import Patch, kept_amplitude, ridge_width_px, spread_patches
from tests.benchmarks.accuracy.pattern_frames import mosaic_frame, pattern_light
from tests.benchmarks.accuracy.twin_frame_set import make_frame_set
from tests.benchmarks.accuracy.twin_instrument import TwinInstrument


@dataclass(frozen=True, slots=True)
class Resolution:
    """What a height map of the test pattern retains.

    kept : fraction of the amplitude of every sinusoid, by its period in pixels
    widths_px : width of every ridge, pixels
    """

    kept: dict[float, tuple[float, ...]]
    widths_px: tuple[float, ...]

    @classmethod
    def of(cls, height: HeightMap, patches: Sequence[Patch]) -> Resolution:
        """The resolution that a height map of these patches shows."""
        z_px = height.z_um / height.pitch_um
        waves = [patch for patch in patches if patch.kind == "sinusoid"]
        ridges = [patch for patch in patches if patch.kind == "ridge"]
        periods = sorted({patch.scale_px for patch in waves})
        kept = {
            period: tuple(kept_amplitude(z_px, patch) for patch in waves if patch.scale_px == period)
            for period in periods
        }
        return cls(kept, tuple(ridge_width_px(z_px, patch) for patch in ridges))

    def least_kept(self, period_px: float) -> float:
        """The worst of the sinusoids of one period."""
        return min(self.kept[period_px])

    @property
    def widest_px(self) -> float:
        """The widest ridge, pixels."""
        return max(self.widths_px)


def three_channel_resolution(profile: BoardProfile, folder: Path, method: Method | None = None) -> Resolution:
    """Resolution without mosaic, with a lens without blur, calibrated on frames of the same camera.

    folder : where the frame set is written
    """
    sharp = msgspec.structs.replace(profile, twin=msgspec.structs.replace(profile.twin, point_spread_px=0.0))
    patches = spread_patches((profile.sensor.rows, profile.sensor.columns))
    frame_set = make_frame_set(sharp, patches, folder)
    calibration = calibrate_frame_set(frame_set)
    scan = frame_set.scans[0]
    found = reconstruct(read_frame(scan.frame), calibration, scan.name, method)
    return Resolution.of(found.height, patches)


def mosaic_resolution(instrument: TwinInstrument, method: Method | None = None) -> Resolution:
    """Resolution of an instrument's own camera, with its mosaic and lens."""
    profile = instrument.profile
    patches = spread_patches((profile.sensor.rows, profile.sensor.columns))
    frame = mosaic_frame(profile, pattern_light(profile, patches), seed=100)
    found = reconstruct(demosaic(frame), instrument.calibration, "pattern", method)
    return Resolution.of(found.height, patches)
