"""CPU seconds and memory of measuring 12 megapixels with 16 samples: everything areal, both filters, a profile.

usage: python -m tests.benchmarks.measurement.speed [--without-samples]
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np

from device.surface import Float32Array, HeightMap
from host_sync.measurement.measure import measure
from host_sync.measurement.recipe import ProfileTable, Recipe
from host_sync.results.reader import ResultSurface
from host_sync.results.record import ResultRecord

SHAPE: Final = (3000, 4000)
PITCH_UM: Final = 3.4
DRAWS: Final = 16


def main() -> int:
    """Measure twice, the first time to compile; print the cost of the second; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--without-samples", action="store_true")
    samples = 0 if parser.parse_args().without_samples else DRAWS
    recipe = Recipe(
        form="polynomial-2",
        s_filter_um=10.0,
        l_filter_um=800.0,
        profile=(ProfileTable(name="line", from_um=(100.0, 5000.0), to_um=(13000.0, 5000.0), l_filter_um=800.0),),
    )
    measure(synthetic((300, 400), 2), recipe_for_small())
    surface = synthetic(SHAPE, samples)
    before_s, wall_s = time.process_time(), time.perf_counter()
    found = measure(surface, recipe)
    spent_s = time.process_time() - before_s
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    sys.stdout.write(
        f"{SHAPE[1]}x{SHAPE[0]} pixels, {samples} samples, {len(found.quantities)} numbers: "
        f"{spent_s:.0f} s CPU, {time.perf_counter() - wall_s:.0f} s, peak {peak_mb:.0f} MB\n"
    )
    return 0


def recipe_for_small() -> Recipe:
    """A recipe that compiles every kernel."""
    return Recipe(s_filter_um=10.0, l_filter_um=200.0)


def synthetic(shape: tuple[int, int], samples: int) -> ResultSurface:
    """Noise that is rough over a few pixels, with a hole, and samples of the size that reconstruction keeps."""
    random = np.random.default_rng(0)
    z_um: Float32Array = random.standard_normal(shape, np.float32)
    z_um += np.float32(5.0) * np.sin(np.arange(shape[1], dtype=np.float32) / np.float32(30.0))
    z_um[100:140, 200:260] = np.nan
    cell = max(1, -(-shape[1] // 512))
    errors = random.standard_normal((samples, shape[0] // cell, shape[1] // cell), np.float32)
    return ResultSurface(
        folder=Path("synthetic"),
        record=ResultRecord(
            schema="",
            name="synthetic",
            rows=shape[0],
            columns=shape[1],
            pixel_pitch_um=PITCH_UM,
        ),
        height=HeightMap(z_um, PITCH_UM),
        samples_um=errors if samples else None,
        slope_sigma=np.full(shape, 0.02, np.float32),
    )


if __name__ == "__main__":
    sys.exit(main())
