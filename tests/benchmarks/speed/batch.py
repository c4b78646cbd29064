"""A batch of raw files through two single-thread processes: by a bare process pool, and by Dask where it is installed.

Paths go to the processes and figures come back: frames are read and heights stay where they are made. The product needs
neither; Dask is in no list of requirements and must be installed for its figure (`pip install distributed`).
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from device.bundles.raw_frame import read_raw, write_raw
from hal.frame import RawFrame
from host_sync.calibration.calibrate import Calibration
from host_sync.frames.sequence import StoredFrame
from host_sync.video.frame_solver import FrameSolver
from tests.benchmarks.speed.fresh import thread_settings
from tests.benchmarks.speed.plan import Plan, Shape
from tests.benchmarks.speed.video import sequence

WORKERS = 2
ROUNDS = 3
Batch = Callable[[Sequence[Path]], float]


def measure(plan: Plan, calibration: Calibration, folder: Path, shape: Shape) -> dict[str, Any]:
    """Frames per second of both, and their ratio; best of several rounds in turns."""
    frames, full = sequence(calibration, folder, shape, plan.frames)
    stored = folder / "batch-calibration.pickle"
    stored.write_bytes(pickle.dumps(full))
    paths = [folder / f"batch-{number}.tif" for number in range(len(frames))]
    for path, frame in zip(paths, frames, strict=True):
        assert isinstance(frame.pixels, RawFrame)
        write_raw(path, frame.pixels)
    context = get_context("spawn")
    with thread_settings(1), ProcessPoolExecutor(WORKERS, context) as pool:
        batches: dict[str, Batch] = {
            "pool_fps": lambda some: _fps(lambda: list(pool.map(peak_um, [stored] * len(some), some)))
        }
        if find_spec("distributed") is None:
            return _best(batches, paths, plan)
        from distributed import Client, LocalCluster

        with (
            LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            batches["dask_fps"] = lambda some: _fps(
                lambda: client.gather(client.map(peak_um, [stored] * len(some), some, pure=False))
            )
            rates = _best(batches, paths, plan)
    return rates | {"dask_over_pool": rates["dask_fps"] / rates["pool_fps"]}


def peak_um(stored_calibration: Path, path: Path) -> float:
    """The highest point of a frame's relief; heights are dropped."""
    solver = _solver(stored_calibration)
    out = np.empty(solver.shape, np.float32)
    figures = solver.solve(StoredFrame(path.name, read_raw(path)), out)
    assert figures.peak_um is not None
    return figures.peak_um


@cache
def _solver(stored_calibration: Path) -> FrameSolver:
    cv2.setNumThreads(1)
    return FrameSolver(pickle.loads(stored_calibration.read_bytes()), "direct", None)  # noqa: S301 - `measure` wrote it


def _fps(solve: Callable[[], list[float]]) -> float:
    began = time.perf_counter()
    count = len(solve())
    return count / (time.perf_counter() - began)


def _best(batches: dict[str, Batch], paths: list[Path], plan: Plan) -> dict[str, float]:
    """Best rate of each, after a first round that loads compiled code."""
    rounds = [{name: batch(paths) for name, batch in batches.items()} for _ in range(1 if plan.quick else 1 + ROUNDS)]
    return {name: max(rates[name] for rates in rounds[-ROUNDS:]) for name in batches}
