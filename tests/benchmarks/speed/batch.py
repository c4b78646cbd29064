"""Raw files to results on disk by the product's own batches: one and two single-thread processes, and two workers of a
dask cluster, where dask is installed (extra `cluster`; `make bench` installs it with the peers).

A rate counts from the moment when every worker has done a scan: starting processes and loading compiled code are
not in it. Paths go to the workers and figures come back.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2

from device.bundles.raw_frame import read_raw
from device.imaging.flat_field import demosaic
from host_sync.batch.cluster import connected, outcomes_on_cluster
from host_sync.batch.worker_pool import outcomes_of
from host_sync.calibration.calibrate import Calibration
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.result_writer import write_result
from tests.benchmarks.speed.plan import Plan, Shape, named
from tests.benchmarks.speed.specimen import resampled

WORKERS = 2
ROUNDS = 2
SCANS = 24


@dataclass(frozen=True)
class RawToResults:
    """Reconstructs one raw file again and again; each task's results have a folder of their own.

    calibration : pickled
    """

    calibration: Path
    raw: Path
    out: Path

    def __call__(self) -> Callable[[int], str]:
        cv2.setNumThreads(1)
        calibration: Calibration = pickle.loads(self.calibration.read_bytes())  # noqa: S301 - `measure` wrote it

        def work(number: int) -> str:
            name = f"{self.raw.stem}-{number}"
            write_result(self.out / name, reconstruct(read_raw(self.raw), calibration, name), calibration, name)
            return name

        return work


def measure(plan: Plan, calibration: Calibration, folder: Path, shape: Shape) -> dict[str, Any]:
    """Scans per second of each way, and ratios; best of several rounds in turns."""
    full = resampled(calibration, demosaic(read_raw(folder / f"reference-{named(shape)}.tif")))
    stored = folder / "batch-calibration.pickle"
    stored.write_bytes(pickle.dumps(full))
    work = RawToResults(stored, folder / f"coin-{named(shape)}.tif", folder / "batch")
    numbers = range(2 * WORKERS if plan.quick else SCANS)
    ways: dict[str, Callable[[], float]] = {
        "one_process": lambda: _rate(outcomes_of(numbers, work, 1), 1),
        "two_processes": lambda: _rate(outcomes_of(numbers, work, WORKERS), WORKERS),
    }
    rounds = range(1 if plan.quick else ROUNDS)
    if find_spec("distributed") is None:
        rates = _best([{name: way() for name, way in ways.items()} for _ in rounds])
    else:
        from distributed import LocalCluster

        with (
            LocalCluster(n_workers=WORKERS, threads_per_worker=1, dashboard_address=":0") as cluster,
            connected(cluster.scheduler_address) as client,
        ):
            ways["cluster"] = lambda: _rate(outcomes_on_cluster(client, numbers, work, folder), WORKERS)
            rates = _best([{name: way() for name, way in ways.items()} for _ in rounds])
        rates["cluster_over_pool"] = rates["cluster"] / rates["two_processes"]
    return rates | {"two_over_one": rates["two_processes"] / rates["one_process"]}


def _rate(outcomes: Iterator[tuple[int, object]], workers: int) -> float:
    """Scans per second, without the first of each worker."""
    began, count = 0.0, 0
    for count, (number, outcome) in enumerate(outcomes, start=1):
        assert isinstance(outcome, str), f"scan {number}: {outcome}"
        if count == workers:
            began = time.perf_counter()
    return (count - workers) / (time.perf_counter() - began)


def _best(rounds: list[dict[str, float]]) -> dict[str, float]:
    return {name: max(rates[name] for rates in rounds) for name in rounds[0]}
