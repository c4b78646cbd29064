"""A mosaic of presses on two gels of the whole twin, each with a calibration of its own: its seams and its heights.

    python -m tests.benchmarks.mosaic.two_gels [--side 3] [--first 0]

Worn metal and gels as in `gel_change`; gels take turns as on a chessboard, so that every seam between neighbours lies
between two calibrations. Presses are shifted and turned as by a hand.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from host_sync.mosaic.presses import Fields, Press
from host_sync.mosaic.stitch import stitch
from host_sync.mosaic.writing import LinkRecord, MosaicRecord
from host_sync.reconstruction.pipeline import Reconstruction
from host_sync.results.record import ResultRecord
from tests.benchmarks.mosaic.gel_change import PRESSED_MM, Gel
from tests.benchmarks.mosaic.ruler import GRAIN_MM, ReliefMap

STEP_MM: Final = (8.0, 10.8)
"""Distance of presses: 39 % and 38 % of the field in common."""

SIZES_MM: Final = ((1.2, 0.03), (0.4, 0.008), (0.15, 0.002))
"""Size of the metal's hills, and their height."""


def large_metal(side: int, seed: int = 22) -> ReliefMap:
    """Worn metal as large as a mosaic of side × side presses."""
    random = np.random.default_rng(seed)
    shape = tuple(round((step * side + 14.0) / GRAIN_MM) for step in STEP_MM)
    z_mm = np.zeros(shape, np.float32)
    for size_mm, height_mm in SIZES_MM:
        field = cv2.GaussianBlur(random.standard_normal(shape).astype(np.float32), (0, 0), size_mm / GRAIN_MM)
        z_mm += np.float32(height_mm / field.std()) * field
    return ReliefMap(z_mm - z_mm.max())


def presses(metal: ReliefMap, gels: list[Gel], side: int, random: np.random.Generator) -> list[Press]:
    """side × side presses, named by row, column and gel."""
    found = []
    for row in range(side):
        for column in range(side):
            number = (row + column) % len(gels)
            centre = [(0.5 * (side - 1) - at) * step for at, step in zip((row, column), STEP_MM, strict=True)]
            right_mm, down_mm = centre[1] + random.normal(0.0, 0.4), centre[0] + random.normal(0.0, 0.4)
            turn = float(np.radians(random.normal(0.0, 2.0)))
            depth_mm = PRESSED_MM * random.uniform(0.9, 1.1)
            seen = gels[number].reconstructed(metal, (float(right_mm), -float(down_mm)), turn, float(depth_mm))
            found.append(_press(f"{row}-{column}-gel-{number}", seen, number))
    return found


def _press(name: str, seen: Reconstruction, gel: int) -> Press:
    z_um, pitch_um = seen.height.z_um, seen.height.pitch_um
    record = ResultRecord(
        name=name,
        rows=z_um.shape[0],
        columns=z_um.shape[1],
        pixel_pitch_um=pitch_um,
        calibration_id=f"gel-{gel}",
        height_zero=seen.datum.words if hasattr(seen.datum, "words") else "",
    )
    return Press(name, record, lambda: Fields(z_um, seen.sigma_um, seen.extrapolated))


def between_gels(link: LinkRecord) -> bool:
    """Whether a link's presses were made on two gels."""
    return link.first[-1] != link.second[-1]


def told(record: MosaicRecord) -> list[str]:
    """What is to be said of a mosaic."""
    lines = [f"{len(record.presses)} presses, {len(record.used)} overlaps, {len(record.rejected)} rejected"]
    lines.append(f"left out: {', '.join(record.left_out) or 'none'}; pixel pitch {record.pixel_pitch_um:g} µm")
    for words, links in (
        ("between gels", [one for one in record.used if between_gels(one)]),
        ("on one gel", [one for one in record.used if not between_gels(one)]),
    ):
        sigmas = [one.seam_sigmas for one in links if one.seam_sigmas is not None]
        heights = [one.seam_um for one in links if one.seam_um is not None]
        if sigmas:
            lines.append(
                f"seams {words}: {len(sigmas)}, {np.median(sigmas):.2f} σ in the median, {max(sigmas):.2f} σ at worst; "
                f"{np.median(heights):.2f} µm in the median, {max(heights):.2f} µm at worst"
            )
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--side", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="number of the first gel")
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    random = np.random.default_rng(options.first)
    with tempfile.TemporaryDirectory() as folder:
        gels = [Gel(options.first + number, Path(folder) / f"{number}") for number in range(2)]
        record = stitch(presses(large_metal(options.side), gels, options.side, random), Path(folder) / "whole")
    for line in told(record):
        sys.stdout.write(line + "\n")
    sys.stdout.write(f"{time.perf_counter() - started:.0f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
