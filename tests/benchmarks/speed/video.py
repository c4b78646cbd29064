"""A sequence of raw frames in memory to height maps, and their difference to those of each frame alone.

Lights and lens stay while the coin moves: its shading relative to untouched skin is shifted. Black specks of dust lie
on the skin and have low weight: without them every pixel of such a press has the same weight.

Rates are those of whole sequences: frames are solved in parallel as by `retrosync video`, including beginning and end,
when not all threads have a frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from device.bundles.raw_frame import read_raw
from device.imaging.flat_field import demosaic
from device.surface import MaskArray
from hal.frame import RawFrame
from host_sync.calibration.calibrate import Calibration
from host_sync.frames.sequence import StoredFrame
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.video.frame_solver import FrameSolver
from host_sync.video.stream import FrameStream, SolvedFrame
from tests.benchmarks.speed.plan import Plan, Shape, named
from tests.benchmarks.speed.specimen import resampled
from tests.benchmarks.speed.timing import Stopwatch

STEP_PX = 16
"""Distance that the coin moves per frame; even, so that colours stay on their pixels."""

REST_BLUR_PX = 8.0
"""Smoothing of untouched skin, in pixels of one colour: a frame has noise of its own."""

SPECKS = 40
LARGEST_SPECK = 0.006
"""Radius of a speck, as a fraction of the frame's columns."""

COMPARED = 2
"""Frames that are reconstructed alone, too."""

NEAR_DUST_PX = 81


def measure(
    plan: Plan, calibration: Calibration, folder: Path, report_progress: Callable[[str], None]
) -> dict[str, Any]:
    """Frames per second (of the fastest run of the sequence, and of the median one) with and without weights."""
    shape = plan.small if plan.small in plan.scans else plan.scans[0]
    report_progress(f"video, {named(shape)}")
    frames, full = sequence(calibration, folder, shape, plan.frames)
    figures: dict[str, Any] = {"size": named(shape)}
    for name, weighted in (("weighted", True), ("unweighted", False)):
        watch = Stopwatch()
        with FrameStream(FrameSolver(full, "direct", None, weighted=weighted)) as stream:
            solve_all(stream, frames)
            for _ in range(plan.rounds):
                watch.run(partial(solve_all, stream, frames))
            off = [_off_sigma(solved, full) for solved in stream.solve(frames[:COMPARED])]
        times = {key: watch.figures[key] / len(frames) for key in ("min_ms", "median_ms")}
        rates = {"best_fps": 1e3 / times["min_ms"], "median_fps": 1e3 / times["median_ms"]}
        ninety, largest = (max(part) for part in zip(*off, strict=True))
        figures[name] = times | rates | {"off_sigma_p90": ninety, "off_sigma": largest}
    return figures


def solve_all(stream: FrameStream, frames: list[StoredFrame]) -> None:
    """Solve every frame; heights are dropped."""
    for solved in stream.solve(frames):
        assert solved.statistics is not None, solved.reason


def _off_sigma(solved: SolvedFrame, calibration: Calibration) -> tuple[float, float]:
    """Difference of a frame's heights to those of the frame reconstructed alone, in its uncertainties: the 90th
    percentile and the largest, away from specks of dust, which neither of both sees through.
    """
    assert isinstance(solved.frame, StoredFrame)
    assert isinstance(solved.frame.pixels, RawFrame)
    alone = reconstruct(solved.frame.pixels, calibration, solved.name, "direct", detail="raw")
    off = np.abs(solved.height_um - alone.height.z_um) / alone.sigma_um
    near = cv2.dilate(_dust(solved.height_um.shape).astype(np.uint8), np.ones((NEAR_DUST_PX,) * 2, np.uint8)) > 0
    return float(np.nanquantile(off[~near], 0.9)), float(np.nanmax(off[~near]))


def sequence(calibration: Calibration, folder: Path, shape: Shape, count: int) -> tuple[list[StoredFrame], Calibration]:
    """Raw frames of (H, W) pixels in which a coin moves, and their calibration."""
    coin = read_raw(folder / f"coin-{named(shape)}.tif")
    reference = read_raw(folder / f"reference-{named(shape)}.tif")
    dust = _dust(shape)
    frames = [StoredFrame(f"frame {k}", _shifted(coin, reference, dust, STEP_PX * k)) for k in range(count)]
    return frames, resampled(calibration, demosaic(reference))


def _dust(shape: Shape) -> MaskArray:
    """Positions of specks: bool array of shape (H, W)."""
    rows, columns = shape
    random, found = np.random.default_rng(0), np.zeros(shape, np.uint8)
    for _ in range(SPECKS):
        centre = int(random.uniform(0, columns)), int(random.uniform(0, rows))
        cv2.circle(found, centre, 1 + int(random.uniform(0.0, LARGEST_SPECK) * columns), 1, cv2.FILLED)
    return found.astype(np.bool_)


def _shifted(coin: RawFrame, reference: RawFrame, dust: MaskArray, columns: int) -> RawFrame:
    """The frame of the coin with its relief moved to the right, under unchanged lights and dust."""
    black = np.float32(reference.black_level_dn)
    rest = np.empty(reference.shape, np.float32)
    for row, column in np.ndindex(2, 2):
        colour = reference.mosaic[row::2, column::2].astype(np.float32) - black
        rest[row::2, column::2] = cv2.GaussianBlur(colour, (0, 0), REST_BLUR_PX)
    shading = (coin.mosaic.astype(np.float32) - black) / rest
    counts = np.where(dust, np.float32(0.0), np.roll(shading, columns, axis=1) * rest) + black
    return replace(coin, mosaic=np.clip(np.rint(counts), 0.0, coin.white_level_dn).astype(np.uint16))
