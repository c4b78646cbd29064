"""The handheld's budget: one core, numpy, scipy and OpenCV, from raw counts to the quick look's height map."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from device.bundles.raw_frame import read_raw
from device.imaging.flat_field import bin_bayer, flat_field_correct
from device.inverse_map.model import InverseMap
from device.quick_look.solver import (
    QuickLookModel,
    measure_rest,
    quick_look,
    skin_at_rest,
)
from device.surface import Float32Array, Float64Array, GradientField, integrate_dct
from tests.benchmarks.speed.fresh import fresh
from tests.benchmarks.speed.height_error import error_share
from tests.benchmarks.speed.plan import Plan, Shape, named
from tests.benchmarks.speed.timing import side_by_side

ROUNDS = 40


def measure(
    plan: Plan, maps: dict[Shape, InverseMap], folder: Path, report_progress: Callable[[str], None]
) -> dict[str, Any]:
    """All figures of the handheld, by size of the raw frame."""
    figures = {}
    for shape in plan.handheld:
        report_progress(f"handheld, {named(shape)}")
        figures[named(shape)] = fresh(look, maps[shape], folder, shape, min(ROUNDS, 20 * plan.rounds), threads=1)
    return figures


def look(inverse_map: InverseMap, folder: Path, shape: Shape, rounds: int) -> dict[str, Any]:
    """Total and stages of a quick look of (H, W) pixels on one core, and the accuracy of its slopes and heights.

    Slopes are compared with the map that their tables represent, heights with the true coin.
    """
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    cv2.setNumThreads(1)
    frame = read_raw(folder / f"coin-{named(shape)}.tif")
    reference = read_raw(folder / f"reference-{named(shape)}.tif")
    tabled = replace(inverse_map, near=None, light=None)  # the curve of intensity, which alone the handheld fits
    rest = measure_rest(reference, [])
    model = QuickLookModel.prepare(reference, tabled, pitch_um=1.0, rest=rest)
    binned = bin_bayer(frame, model.binning)
    intensity = flat_field_correct(binned, model.flat_field)
    slopes = model.slopes.gradients(intensity)
    methods: dict[str, Callable[[], Any]] = {
        "total": lambda: quick_look(bin_bayer(frame, model.binning), model),
        "bin": lambda: bin_bayer(frame, model.binning),
        "intensity": lambda: flat_field_correct(binned, model.flat_field),
        "look up": lambda: model.slopes.gradients(intensity),
        "skin at rest": lambda: rest and skin_at_rest(intensity, rest),
        "integrate": lambda: integrate_dct(slopes.p, slopes.q, 1.0),
        "untabulated map": lambda: tabled.gradients(intensity, model.binning),
        "build the tables": lambda: QuickLookModel.prepare(reference, tabled, pitch_um=1.0),
    }
    figures: dict[str, Any] = side_by_side(methods, rounds)
    exact = tabled.gradients(intensity, model.binning)
    difference = np.hypot(slopes.p - exact.p, slopes.q - exact.q)[exact.valid]
    figures["slope_difference_mean"] = float(difference.mean())
    truth = _reduced(np.load(folder / f"coin-{named(shape)}.npy"), model.binning)
    figures["height_error_share"] = error_share(quick_look(binned, model).height.z_um, truth)
    figures["untabulated_height_error_share"] = error_share(_heights(exact) * model.binning, truth)
    figures["height_size"] = named(binned.shape)
    figures["needs_numba"] = "numba" in sys.modules
    return figures


def _heights(slopes: GradientField) -> Float32Array:
    """Heights that a quick look computes from these slopes, in sensor pixels over its binning."""
    trusted = np.minimum(np.float32(2.0) * slopes.weight, np.float32(1.0))
    return integrate_dct(np.nan_to_num(slopes.p) * trusted, np.nan_to_num(slopes.q) * trusted, 1.0)


def _reduced(truth_px: Float32Array, binning: int) -> Float64Array:
    """True heights averaged over a quick look's pixels, sensor pixels."""
    rows, columns = (size // binning for size in truth_px.shape)
    cells = truth_px[: rows * binning, : columns * binning].reshape(rows, binning, columns, binning)
    return np.asarray(cells.mean(axis=(1, 3), dtype=np.float64))
