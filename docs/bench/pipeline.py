"""The whole way of a scan, from a raw file to results on disk, each size in a process of its own."""

from __future__ import annotations

import cProfile
import pstats
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from fresh import forget_peak, fresh, peak_mb
from plan import Plan, Shape, named
from specimen import resampled

from device.photometry import demosaic
from device.raw_file import read_raw
from host_sync.calibration.full_calibration import Calibration
from host_sync.reconstruction.pipeline import reconstruct_raw
from host_sync.reconstruction.results import write_result

RUNS = 3
"""Runs that count, after the first; one in a quick benchmark."""

STAGES = {
    "read the raw file": ("raw_file.read_raw",),
    "intensity": ("intensity_kernel.raw_intensity",),
    "doubts": ("intensity_checks.check_intensity", "plausibility.frame_doubts", "plausibility.rest_doubts"),
    "slopes": ("pipeline.estimate",),
    "integration": ("multigrid.integrate",),
    "level": ("level.untouched_skin", "level.levelled"),
    "slopes of the surface": ("surface.surface_slopes",),
    "sigma map": ("uncertainty.slopes_at_rest", "uncertainty.contradicted_slope", "uncertainty.height_uncertainty"),
    "sigma of slopes": ("uncertainty.slope_sigma",),
    "extrapolation": ("extrapolation.extrapolated",),
    "results on disk": ("results.write_result",),
}
"""Stages by the functions that do them, with their modules; the profiler is asked for their cumulated times."""


def measure(plan: Plan, calibration: Calibration, folder: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """Every figure of the whole pipeline, by size."""
    figures = {}
    for shape in plan.scans:
        tell(f"whole pipeline, {named(shape)}")
        figures[named(shape)] = fresh(run_pipeline, calibration, folder, shape, 1 if plan.quick else RUNS)
    return figures


def run_pipeline(calibration: Calibration, folder: Path, shape: Shape, runs: int) -> dict[str, Any]:
    """Total and stages (ms) and peak memory (MB) of a scan of (H, W) pixels; the first run loads compiled code."""
    raw = folder / f"coin-{named(shape)}.tif"
    full = resampled(calibration, demosaic(read_raw(folder / f"reference-{named(shape)}.tif")))
    forget_peak()
    totals_ms = [_timed(raw, full, folder)]
    peak = peak_mb()
    totals_ms += [_timed(raw, full, folder) for _ in range(runs)]
    profile = cProfile.Profile()
    profile.runcall(_scan_to_results, raw, full, folder)
    return {
        "megapixels": shape[0] * shape[1] / 1e6,
        "first_ms": totals_ms[0],
        "min_ms": min(totals_ms[1:]),
        "median_ms": median(totals_ms[1:]),
        "peak_mb": peak,
        "stages_ms": _stages_ms(profile),
    }


def _timed(raw: Path, calibration: Calibration, folder: Path) -> float:
    began = time.perf_counter()
    _scan_to_results(raw, calibration, folder)
    return 1e3 * (time.perf_counter() - began)


def _scan_to_results(raw: Path, calibration: Calibration, folder: Path) -> None:
    result = reconstruct_raw(read_raw(raw), calibration, raw.name)
    write_result(folder / "results", result, calibration, raw.stem)


def _stages_ms(profile: cProfile.Profile) -> dict[str, float]:
    """Cumulated time of every stage, ms."""
    cumulated_ms: dict[str, float] = {}
    for (file, _, name), (_, _, _, cumulated_s, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        if Path(file).suffix == ".py":
            key = f"{Path(file).stem}.{name}"
            # Of functions of one name in one module, one calls the other.
            cumulated_ms[key] = max(cumulated_ms.get(key, 0.0), 1e3 * cumulated_s)
    return {stage: sum(cumulated_ms[name] for name in names) for stage, names in STAGES.items()}
