"""A sequence of raw frames in memory to height maps, and how far they are from converged ones.

Rates are those of whole sequences: frames are solved side by side as `retrosync video` does it, beginning and end
included, when not all threads have a frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from plan import Plan, Shape, named
from specimen import resampled
from timing import Stopwatch

from device.photometry import demosaic
from device.raw_file import read_raw
from device.surface import Float32Array, GradientField
from hal.frame import RawFrame
from host_sync.calibration.full_calibration import Calibration
from host_sync.frame_sequence import StoredFrame
from host_sync.reconstruction.frame_crew import FrameCrew
from host_sync.reconstruction.frame_solver import FrameSolver
from host_sync.reconstruction.intensity_kernel import raw_intensity
from host_sync.reconstruction.multigrid import integrate
from host_sync.reconstruction.pipeline import estimate

STEP_PX = 16
EXACT_TOLERANCE_PX = 1e-6


def measure(plan: Plan, calibration: Calibration, folder: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """Frames a second (of the quickest run of the sequence, and of the median one) with weights and without."""
    shape = plan.small if plan.small in plan.scans else plan.scans[0]
    tell(f"video, {named(shape)}")
    frames, full = sequence(calibration, folder, shape, plan.frames)
    figures: dict[str, Any] = {"size": named(shape)}
    for name, weighted in (("weighted", True), ("unweighted", False)):
        watch = Stopwatch()
        with FrameCrew(FrameSolver(full, "direct", None, weighted=weighted), spare=0) as crew:
            solve_all(crew, frames)
            for _ in range(plan.rounds):
                last = watch.run(partial(solve_all, crew, frames))
        times = {key: watch.figures[key] / len(frames) for key in ("min_ms", "median_ms")}
        rates = {"best_fps": 1e3 / times["min_ms"], "median_fps": 1e3 / times["median_ms"]}
        figures[name] = times | rates | {"rmse_px": _error_px(frames[-1], full, last, weighted=weighted)}
    return figures


def solve_all(crew: FrameCrew, frames: list[StoredFrame]) -> Float32Array:
    """The last frame's heights; the others' are dropped."""
    z_um = np.empty(0, np.float32)
    for outcome, z_um in crew.solved(frames):
        assert outcome.figures is not None, outcome.reason  # noqa: S101 - a refused frame costs nothing
        crew.give_back(z_um)
    return z_um.copy()


def _error_px(frame: StoredFrame, calibration: Calibration, z_um: Float32Array, *, weighted: bool) -> float:
    """Root mean square difference of a frame's heights to those of the same slopes run until nothing is left, px."""
    assert isinstance(frame.pixels, RawFrame)  # noqa: S101 - `sequence` made it
    slopes = estimate(raw_intensity(frame.pixels, calibration.divisor), calibration, "direct")
    if not weighted:
        p, q = (np.where(slopes.valid, slope, np.float32(0.0)) for slope in (slopes.p, slopes.q))
        slopes = GradientField(p, q, np.ones(p.shape, np.bool_), np.ones(p.shape, np.float32))
    converged, _ = integrate(slopes, calibration.pitch_um, tolerance_px=EXACT_TOLERANCE_PX)
    difference = (z_um - converged.z_um)[slopes.valid].astype(np.float64)
    return float(difference.std() / calibration.pitch_um)


def sequence(calibration: Calibration, folder: Path, shape: Shape, count: int) -> tuple[list[StoredFrame], Calibration]:
    """Raw frames of (H, W) pixels in which a coin moves, and their calibration."""
    coin = read_raw(folder / f"coin-{named(shape)}.tif")
    reference = read_raw(folder / f"reference-{named(shape)}.tif")
    frames = [
        StoredFrame(f"frame {k}", replace(coin, mosaic=np.roll(coin.mosaic, STEP_PX * k, axis=1))) for k in range(count)
    ]
    return frames, resampled(calibration, demosaic(reference))
