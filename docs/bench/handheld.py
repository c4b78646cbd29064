"""The handheld's budget: one core, numpy, scipy and OpenCV, from raw counts to the quick look's height map."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fresh import fresh
from plan import Plan, Shape, named
from timing import side_by_side

from device.fft_integrator import integrate_dct
from device.inverse_map import InverseMap
from device.photometry import bin_bayer, divide
from device.quick_look import QuickLookModel, quick_look
from device.raw_file import read_raw
from device.surface import Float32Array

ROUNDS = 40


def measure(plan: Plan, maps: dict[Shape, InverseMap], folder: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """Every figure of the handheld, by size of the raw frame."""
    figures = {}
    for shape in plan.handheld:
        tell(f"handheld, {named(shape)}")
        figures[named(shape)] = fresh(look, maps[shape], folder, shape, min(ROUNDS, 20 * plan.rounds), threads=1)
    return figures


def look(inverse_map: InverseMap, folder: Path, shape: Shape, rounds: int) -> dict[str, Any]:
    """Total and stages of a quick look of (H, W) pixels on one core, and how right its slopes and heights are.

    Slopes are compared with the map that their tables stand for, heights with the coin as it lies.
    """
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    cv2.setNumThreads(1)
    frame = read_raw(folder / f"coin-{named(shape)}.tif")
    reference = read_raw(folder / f"reference-{named(shape)}.tif")
    model = QuickLookModel.prepare(reference, inverse_map, pitch_um=1.0)
    binned = bin_bayer(frame, model.binning)
    intensity = divide(binned, model.divisor)
    slopes = model.slopes.gradients(intensity)
    methods: dict[str, Callable[[], Any]] = {
        "total": lambda: quick_look(bin_bayer(frame, model.binning), model),
        "bin": lambda: bin_bayer(frame, model.binning),
        "intensity": lambda: divide(binned, model.divisor),
        "look up": lambda: model.slopes.gradients(intensity),
        "integrate": lambda: integrate_dct(slopes.p, slopes.q, 1.0),
        "untabulated map": lambda: inverse_map.gradients(intensity, model.binning),
        "build the tables": lambda: QuickLookModel.prepare(reference, inverse_map, pitch_um=1.0),
    }
    figures: dict[str, Any] = side_by_side(methods, rounds)
    exact = inverse_map.gradients(intensity, model.binning)
    difference = np.hypot(slopes.p - exact.p, slopes.q - exact.q)[exact.valid]
    figures["slope_difference_mean"] = float(difference.mean())
    truth_px = np.load(folder / f"coin-{named(shape)}.npy")
    figures["height_error_share"] = _height_error_share(quick_look(binned, model).height.z_um, truth_px, model.binning)
    figures["height_size"] = named(binned.shape)
    figures["needs_numba"] = "numba" in sys.modules
    return figures


def _height_error_share(z_px: Float32Array, truth_px: Float32Array, binning: int) -> float:
    """Root mean square error of a reduced height map over that of the true relief, each set to mean zero."""
    rows, columns = z_px.shape
    cells = truth_px[: rows * binning, : columns * binning].reshape(rows, binning, columns, binning)
    truth = cells.mean(axis=(1, 3), dtype=np.float64)
    return float((z_px - truth).std() / truth.std())
