"""A sequence of raw frames in memory to height maps, frame by frame."""

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
from host_sync.calibration.full_calibration import Calibration
from host_sync.frame_sequence import StoredFrame
from host_sync.reconstruction.frame_solver import FrameSolver

STEP_PX = 16


def measure(plan: Plan, calibration: Calibration, folder: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """Frames a second (of the quickest frame, and of the median one) with weights and without."""
    shape = plan.small if plan.small in plan.scans else plan.scans[0]
    tell(f"video, {named(shape)}")
    frames, full = sequence(calibration, folder, shape, plan.frames)
    figures: dict[str, Any] = {"size": named(shape)}
    for name, weighted in (("weighted", True), ("unweighted", False)):
        watch = Stopwatch()
        solver = FrameSolver(full, "direct", None, weighted=weighted)
        out = np.empty(solver.shape, np.float32)
        solver.solve(frames[0], out)
        for frame in frames:
            watch.run(partial(solver.solve, frame, out))
        times = watch.figures
        rates = {"best_fps": 1e3 / times["min_ms"], "median_fps": 1e3 / times["median_ms"]}
        figures[name] = times | rates
    return figures


def sequence(calibration: Calibration, folder: Path, shape: Shape, count: int) -> tuple[list[StoredFrame], Calibration]:
    """Raw frames of (H, W) pixels in which a coin moves, and their calibration."""
    coin = read_raw(folder / f"coin-{named(shape)}.tif")
    reference = read_raw(folder / f"reference-{named(shape)}.tif")
    frames = [
        StoredFrame(f"frame {k}", replace(coin, mosaic=np.roll(coin.mosaic, STEP_PX * k, axis=1))) for k in range(count)
    ]
    return frames, resampled(calibration, demosaic(reference))
