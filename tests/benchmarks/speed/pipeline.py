"""The complete path of a scan, from a raw file to results on disk, each size in its own process.

The cost of the σ map is the difference of whole runs with and without it, both without profiler, in turns. Each follows
one of its own kind that does not count, as a batch has them: after the other kind the system clears pages for 0.4 to
0.8 s more. Runs without σ take it from an earlier run, so that as much is written to disk.
"""

from __future__ import annotations

import cProfile
import pstats
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np

from device.bundles.raw_frame import read_raw
from device.imaging.flat_field import demosaic
from host_sync.calibration.calibrate import Calibration
from host_sync.kernels.jit import get_num_threads, set_num_threads
from host_sync.kernels.process_settings import kept_memory
from host_sync.reconstruction import pipeline, reading_uncertainty
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from host_sync.reconstruction.result_writer import write_result
from host_sync.uncertainty.height_error import HeightUncertainty
from tests.benchmarks.speed.fresh import AS_A_COMMAND, forget_peak, fresh, peak_mb
from tests.benchmarks.speed.height_error import error_share
from tests.benchmarks.speed.plan import Plan, Shape, named
from tests.benchmarks.speed.specimen import resampled
from tests.benchmarks.speed.timing import Stopwatch, side_by_side

RUNS = 3
"""Runs that count, after the first; one in a quick benchmark."""

STAGES = {
    "read the raw file": ("raw_frame.read_raw",),
    "intensity": ("flat_field_kernel.raw_intensity",),
    "frame checks": (
        "flat_field_kernel.check_exposure",
        "frame_model.check",
        "colour_check.check_frame",
        "colour_check.check_datum",
    ),
    "shrinkage": ("bounded_shrinkage.shrunk",),
    "slopes": ("slope_reading.uncorrected",),
    "light model": ("reading.correct_slopes",),
    "raw detail": ("heights.with_raw_detail",),
    "integration": ("integrate.integrate",),
    "level": ("zero_level.find_datum", "zero_level.level"),
    "slopes of the surface": ("integrate.surface_slopes",),
    "sigma map": (
        "height_error.nonintegrable_residual",
        "calibration_uncertainty.calibration_uncertainty",
        "height_error.height_uncertainty",
        "height_error.height_draws",
    ),
    "sigma of slopes": ("height_error.slope_sigma",),
    "extrapolation": ("confidence.extrapolated", "confidence.out_of_domain_blocks"),
    "results on disk": ("result_writer.write_result",),
}
"""Stages by the functions that do them, with their modules.

Times are cumulated times of the profiler on one thread: with several ones stages run beside each other. They are
somewhat too long because it traces every call.
"""

OF_SOME: Final = frozenset({"reading.correct_slopes", "calibration_uncertainty.calibration_uncertainty"})
"""The first is called where held-out balls confirm the light model, the second where they do not."""


def measure(
    plan: Plan, calibration: Calibration, folder: Path, report_progress: Callable[[str], None]
) -> dict[str, Any]:
    """All figures of the pipeline, by size."""
    figures = {}
    for shape in plan.scans:
        report_progress(f"whole pipeline, {named(shape)}")
        figures[named(shape)] = fresh(
            run_pipeline, calibration, folder, shape, 1 if plan.quick else RUNS, settings=AS_A_COMMAND
        )
    return figures


def run_pipeline(calibration: Calibration, folder: Path, shape: Shape, runs: int) -> dict[str, Any]:
    """Total and stages (ms) and peak memory (MB) of a scan of (H, W) pixels; the first run loads compiled code."""
    raw = folder / f"coin-{named(shape)}.tif"
    full = resampled(calibration, demosaic(read_raw(folder / f"reference-{named(shape)}.tif")))
    forget_peak()
    watch = Stopwatch()
    known = watch.run(lambda: _scan_to_results(raw, full, folder))
    first_ms, peak = watch.runs_ms.pop(), peak_mb()
    truth_px = np.load(folder / f"coin-{named(shape)}.npy")
    methods = {
        "with": lambda: _scan_to_results(raw, full, folder),
        "without": lambda: _without_sigma(raw, full, folder, known),
    }
    with kept_memory():  # as in a batch, from the second scan on
        figures = side_by_side(methods, runs, settled=True)
        profile = cProfile.Profile()
        threads = get_num_threads()
        set_num_threads(1)
        profile.runcall(_scan_to_results, raw, full, folder)
        set_num_threads(threads)
    return figures["with"] | {
        "megapixels": shape[0] * shape[1] / 1e6,
        "first_ms": first_ms,
        "peak_mb": peak,
        "height_error_share": error_share(known.height.z_um / np.float32(full.pitch_um), truth_px),
        "stages_ms": _stages_ms(profile),
        "without sigma": figures["without"],
    }


def _scan_to_results(raw: Path, calibration: Calibration, folder: Path) -> Reconstruction:
    result = reconstruct(read_raw(raw), calibration, raw.name)
    write_result(folder / "results", result, calibration, raw.stem)
    return result


def _without_sigma(raw: Path, calibration: Calibration, folder: Path, known: Reconstruction) -> None:
    """The same with the uncertainty of heights known already."""
    sigma = HeightUncertainty(known.sigma_um, known.samples_um)
    spared = (
        (pipeline, "nonintegrable_residual", known.slope_sigma),
        (reading_uncertainty, "height_uncertainty", sigma),
        (reading_uncertainty, "height_draws", None),
    )
    with ExitStack() as stack:
        for module, name, value in spared:
            stack.enter_context(patch.object(module, name, return_value=value))
        _scan_to_results(raw, calibration, folder)


def _stages_ms(profile: cProfile.Profile) -> dict[str, float]:
    """Cumulated time of every stage, ms."""
    cumulated_ms: dict[str, float] = {}
    for (file, _, name), (_, _, _, cumulated_s, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        if Path(file).suffix == ".py":
            key = f"{Path(file).stem}.{name}"
            # Of functions of one name in one module, one calls the other.
            cumulated_ms[key] = max(cumulated_ms.get(key, 0.0), 1e3 * cumulated_s)
    cumulated_ms = dict.fromkeys(OF_SOME, 0.0) | cumulated_ms
    return {stage: sum(cumulated_ms[name] for name in names) for stage, names in STAGES.items()}
