"""Input of the benchmark: a calibration of the twin, and raw frames of the same field at any resolution."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from device.acquisition.calibrate import calibrate
from device.acquisition.capture import CaptureSettings, capture
from device.bundles.calibration import CalibrationBundle
from device.bundles.raw_frame import write_raw
from device.imaging.flat_field import LinearFrame, make_flat_field
from device.inverse_map.model import InverseMap
from device.store.store import BundleStore
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.interfaces import PressObject
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration_file.calibrator import calibration_of
from host_sync.video.fine_pass import at_size as calibration_at_size
from tests.benchmarks.speed.plan import Shape, named

BALL_RADIUS_MM = 3.0


def field_calibration(shape: Shape, presses: int, folder: Path) -> Calibration:
    """The workstation's calibration from this many presses of a guided one on a twin of (H, W) pixels."""
    bundle = twin_calibration(shape, folder)
    chosen = bundle.record.presses[:: max(1, len(bundle.record.presses) // presses)]
    return calibration_of(CalibrationBundle(bundle.directory, msgspec.structs.replace(bundle.record, presses=chosen)))


def twin_calibration(shape: Shape, folder: Path) -> CalibrationBundle:
    """A guided calibration on a twin of (H, W) pixels, published to a store in `folder`."""
    clock = VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0)
    with twin_hardware(build(twin_of(shape), clock)) as hardware:
        return calibrate(
            hardware, BundleStore(folder, clock, boot_id="b0075e1f"), BALL_RADIUS_MM, lambda _: None
        ).bundle


def render(shape: Shape, folder: Path) -> None:
    """Write `reference-CxR.tif` and `coin-CxR.tif`, raw frames of untouched skin and of a coin, and the true heights.

    The heights are in pixels: `coin-CxR.npy`, float32 array of shape (H, W).
    """
    bench = build(twin_of(shape), VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0))
    with twin_hardware(bench) as hardware:
        plan = CaptureSettings.of_board(hardware)
        write_raw(folder / f"reference-{named(shape)}.tif", capture(hardware, plan))
        hardware.operator.ask(PressObject("coin"))
        hardware.button.wait_for_press(None)
        write_raw(folder / f"coin-{named(shape)}.tif", capture(hardware, plan))
        truth = bench.truth()
        np.save(folder / f"coin-{named(shape)}.npy", truth.z_um / np.float32(truth.pitch_um))


def twin_of(shape: Shape) -> BoardProfile:
    """The reference twin with its field sampled by (H, W) pixels."""
    profile = load_board_profile("twin")
    finer = profile.sensor.columns / shape[1]
    pitch_um = profile.sensor.pixel_pitch_um * finer
    sensor = msgspec.structs.replace(profile.sensor, rows=shape[0], columns=shape[1], pixel_pitch_um=pitch_um)
    return msgspec.structs.replace(profile, sensor=sensor)


def resampled(calibration: Calibration, reference: LinearFrame) -> Calibration:
    """The calibration of the same field for frames of the reference's size."""
    return calibration_at_size(calibration, reference, make_flat_field(reference))


def at_size(inverse_map: InverseMap, shape: Shape) -> InverseMap:
    """The inverse map of the same field at (H, W) pixels."""
    return replace(inverse_map, shape=shape)
