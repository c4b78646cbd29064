"""A sequence of raw frames in memory to height maps, and how far they are from those of each frame alone.

Lights and lens stand still while the coin moves: its shading relative to the skin at rest is what is shifted. Specks of
dust lie on the skin, black, and weigh little: without them every pixel of such a press weighs the same.

Rates are those of whole sequences: frames are solved side by side as `retrosync video` does it, beginning and end
included, when not all threads have a frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from plan import Plan, Shape, named
from specimen import resampled
from timing import Stopwatch

from device.photometry import demosaic
from device.raw_file import read_raw
from device.surface import Float32Array, GradientField, MaskArray
from hal.frame import RawFrame
from host_sync.calibration.full_calibration import Calibration
from host_sync.frame_sequence import StoredFrame
from host_sync.reconstruction.frame_crew import FrameCrew
from host_sync.reconstruction.frame_solver import FrameSolver
from host_sync.reconstruction.intensity_kernel import raw_intensity
from host_sync.reconstruction.multigrid import integrate
from host_sync.reconstruction.pipeline import estimate

STEP_PX = 16
"""How far the coin moves from frame to frame; even, so that colours stay on their pixels."""

REST_BLUR_PX = 8.0
"""Smoothing of the skin at rest, of one colour's pixels: a frame brings noise of its own."""

SPECKS = 40
LARGEST_SPECK = 0.006
"""Radius of a speck, as a share of the frame's columns."""

CONVERGED_TOLERANCE_PX = 1e-5
MOST_CYCLES = 40


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
                watch.run(partial(solve_all, crew, frames))
            errors_px = [_error_px(frame, full, z_um, weighted=weighted) for frame, z_um in _heights(crew, frames)]
        times = {key: watch.figures[key] / len(frames) for key in ("min_ms", "median_ms")}
        rates = {"best_fps": 1e3 / times["min_ms"], "median_fps": 1e3 / times["median_ms"]}
        figures[name] = times | rates | {"rmse_px": max(errors_px)}
    return figures


def solve_all(crew: FrameCrew, frames: list[StoredFrame]) -> None:
    """Solve every frame; heights are dropped."""
    for _ in _heights(crew, frames):
        pass


def _heights(crew: FrameCrew, frames: list[StoredFrame]) -> Iterator[tuple[StoredFrame, Float32Array]]:
    """Every frame and its heights, which are written over as soon as the next ones are asked for."""
    for frame, (outcome, z_um) in zip(frames, crew.solved(frames), strict=True):
        assert outcome.figures is not None, outcome.reason  # noqa: S101 - a refused frame costs nothing
        yield frame, z_um
        crew.give_back(z_um)


def _error_px(frame: StoredFrame, calibration: Calibration, z_um: Float32Array, *, weighted: bool) -> float:
    """Root mean square difference of a frame's heights to those of the frame reconstructed alone, px.

    Alone means by the kernels that single scans go through, and integrated until nothing is left to gain.
    """
    assert isinstance(frame.pixels, RawFrame)  # noqa: S101 - `sequence` made it
    slopes = estimate(raw_intensity(frame.pixels, calibration.divisor), calibration, "direct")
    if not weighted:
        p, q = (np.where(slopes.valid, slope, np.float32(0.0)) for slope in (slopes.p, slopes.q))
        slopes = GradientField(p, q, np.ones(p.shape, np.bool_), np.ones(p.shape, np.float32))
    converged, _ = integrate(slopes, calibration.pitch_um, tolerance_px=CONVERGED_TOLERANCE_PX, max_cycles=MOST_CYCLES)
    difference = (z_um - converged.z_um)[slopes.valid].astype(np.float64)
    return float(difference.std() / calibration.pitch_um)


def sequence(calibration: Calibration, folder: Path, shape: Shape, count: int) -> tuple[list[StoredFrame], Calibration]:
    """Raw frames of (H, W) pixels in which a coin moves, and their calibration."""
    coin = read_raw(folder / f"coin-{named(shape)}.tif")
    reference = read_raw(folder / f"reference-{named(shape)}.tif")
    dust = _dust(shape)
    frames = [StoredFrame(f"frame {k}", _shifted(coin, reference, dust, STEP_PX * k)) for k in range(count)]
    return frames, resampled(calibration, demosaic(reference))


def _dust(shape: Shape) -> MaskArray:
    """Where specks lie: bool array of shape (H, W)."""
    rows, columns = shape
    random, found = np.random.default_rng(0), np.zeros(shape, np.uint8)
    for _ in range(SPECKS):
        centre = int(random.uniform(0, columns)), int(random.uniform(0, rows))
        cv2.circle(found, centre, 1 + int(random.uniform(0.0, LARGEST_SPECK) * columns), 1, cv2.FILLED)
    return found.astype(np.bool_)


def _shifted(coin: RawFrame, reference: RawFrame, dust: MaskArray, columns: int) -> RawFrame:
    """The frame of the coin with its relief moved to the right, under lights and dust that stay where they are."""
    black = np.float32(reference.black_level_dn)
    rest = np.empty(reference.shape, np.float32)
    for row, column in np.ndindex(2, 2):
        colour = reference.mosaic[row::2, column::2].astype(np.float32) - black
        rest[row::2, column::2] = cv2.GaussianBlur(colour, (0, 0), REST_BLUR_PX)
    shading = (coin.mosaic.astype(np.float32) - black) / rest
    counts = np.where(dust, np.float32(0.0), np.roll(shading, columns, axis=1) * rest) + black
    return replace(coin, mosaic=np.clip(np.rint(counts), 0.0, coin.white_level_dn).astype(np.uint16))
