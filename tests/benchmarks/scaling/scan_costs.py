"""What one scan costs, measured: seconds of a core, and bytes of its frame and of its results.

usage: python -m tests.benchmarks.scaling.scan_costs [--quick] [--out costs.json]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import msgspec

from tests.benchmarks.speed.plan import FULL, QUICK, Shape, named

RUNS = 5


class ScanCost(msgspec.Struct, frozen=True):
    """One frame size.

    core_s : seconds of one core from the raw file to results on disk, of each run
    raw_bytes, result_bytes : of the raw frame's file, and of all files of the results
    """

    size: str
    core_s: tuple[float, ...]
    raw_bytes: int
    result_bytes: int

    @property
    def mean_core_s(self) -> float:
        """Mean of the runs."""
        return sum(self.core_s) / len(self.core_s)


def measure(shapes: tuple[Shape, ...], presses: int, calibrated: Shape, runs: int) -> list[ScanCost]:
    """The cost of a coin's press on the twin at each size, computed with one thread."""
    from tests.benchmarks.speed.fresh import fresh
    from tests.benchmarks.speed.specimen import field_calibration, render

    with tempfile.TemporaryDirectory(prefix="retrograph-scaling-") as name:
        folder = Path(name)
        calibration = field_calibration(calibrated, presses, folder / "store")
        costs = []
        for shape in shapes:
            fresh(render, shape, folder)
            costs.append(fresh(_cost, calibration, folder, shape, runs, threads=1))
        return costs


def _cost(calibration: object, folder: Path, shape: Shape, runs: int) -> ScanCost:
    import cv2

    from device.bundles.raw_frame import read_raw
    from device.imaging.flat_field import demosaic
    from host_sync.calibration.calibrate import Calibration
    from host_sync.reconstruction.pipeline import reconstruct
    from host_sync.reconstruction.result_writer import write_result
    from tests.benchmarks.speed.specimen import resampled

    cv2.setNumThreads(1)
    assert isinstance(calibration, Calibration)
    full = resampled(calibration, demosaic(read_raw(folder / f"reference-{named(shape)}.tif")))
    raw, out = folder / f"coin-{named(shape)}.tif", folder / f"results-{named(shape)}"
    spent = []
    for _ in range(runs + 1):
        began = time.process_time()
        write_result(out, reconstruct(read_raw(raw), full, raw.stem), full, raw.stem)
        spent.append(time.process_time() - began)
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    return ScanCost(named(shape), tuple(spent[1:]), raw.stat().st_size, size)


def main() -> int:
    """Measure and write; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tiny frame: shows only that it runs")
    parser.add_argument("--out", type=Path, default=Path("costs.json"))
    options = parser.parse_args()
    plan = QUICK if options.quick else FULL
    shapes = plan.scans if options.quick else (plan.small, plan.large)
    costs = measure(shapes, plan.presses, plan.calibrated, 1 if options.quick else RUNS)
    options.out.write_bytes(msgspec.json.format(msgspec.json.encode(costs), indent=2) + b"\n")
    for cost in costs:
        sys.stdout.write(
            f"{cost.size}: {cost.mean_core_s:.2f} s of a core, {cost.raw_bytes} + {cost.result_bytes} bytes\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
