"""Throughput of two single-thread worker processes relative to one, compared with the best that two cores of this
machine reach."""

from __future__ import annotations

import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from host_sync.calibration.calibrate import Calibration
from host_sync.video.frame_solver import FrameSolver
from tests.benchmarks.speed import batch
from tests.benchmarks.speed.fresh import thread_settings
from tests.benchmarks.speed.plan import Plan, Shape
from tests.benchmarks.speed.video import sequence

LONGEST_WAIT_S = 600.0
SPINS = 2_000_000
ROUNDS = 3


def measure(
    plan: Plan, calibration: Calibration, folder: Path, report_progress: Callable[[str], None]
) -> dict[str, Any]:
    """Frames per second of one and of two workers, and the same of processes that only count."""
    shape = plan.small if plan.small in plan.scans else plan.scans[0]
    report_progress("one and two single-thread workers")
    runs = [
        {workers: _rates(workers, calibration, folder, shape, plan.frames // 2) for workers in (1, 2)}
        for _ in range(1 if plan.quick else ROUNDS)
    ]
    one_fps, two_fps = (max(run[workers][0] for run in runs) for workers in (1, 2))
    one_count, two_count = (max(run[workers][1] for run in runs) for workers in (1, 2))
    return {
        "one_worker_fps": one_fps,
        "two_workers_fps": two_fps,
        "scaling": two_fps / one_fps,
        "scaling_of_counting": two_count / one_count,
        "batch": batch.measure(plan, calibration, folder, shape),
    }


def _rates(workers: int, calibration: Calibration, folder: Path, shape: Shape, frames: int) -> tuple[float, float]:
    """Frames per second and counts per second of this many workers together."""
    context = get_context("spawn")
    gate, results = context.Barrier(workers), context.Queue()
    arguments = (gate, results, calibration, folder, shape, frames)
    with thread_settings(1):
        processes = [context.Process(target=_work, args=arguments, daemon=True) for _ in range(workers)]
        for process in processes:
            process.start()
    spent = [results.get(timeout=LONGEST_WAIT_S) for _ in processes]
    for process in processes:
        process.join()
    frames_s, counting_s = (max(part) for part in zip(*spent, strict=True))
    return workers * frames / frames_s, workers * SPINS / counting_s


def _work(gate: Any, results: Any, calibration: Calibration, folder: Path, shape: Shape, frames: int) -> None:
    """Report the seconds for the frames and for counting; all workers start each at the same time."""
    cv2.setNumThreads(1)
    given, full = sequence(calibration, folder, shape, frames)
    solver = FrameSolver(full, "direct", None)
    out = np.empty(solver.shape, np.float32)
    solver.solve(given[0], out)
    gate.wait(LONGEST_WAIT_S)
    frames_s = _seconds(lambda: [solver.solve(frame, out) for frame in given])
    gate.wait(LONGEST_WAIT_S)
    results.put((frames_s, _seconds(_count)))


def _seconds(function: Callable[[], Any]) -> float:
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def _count() -> int:
    total = 0
    for number in range(SPINS):
        total += number
    return total
