"""Processor time of a sensor's video frames on one thread, with and without their uncertainty, and their agreement.

usage: python -m tests.benchmarks.speed.sensor_frames CALIBRATION FRAME...

CALIBRATION is a file of `retrosync calibrate`; the frames are images of that sensor, in turn. Decoding is not included.
Agreement is the difference to the frame reconstructed alone, over the standard uncertainty that it has there.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from pathlib import Path
from typing import Final

import numba
import numpy as np

from device.surface import Float32Array
from host_sync import api
from host_sync.frames.image_file import read_image
from host_sync.video.frame_solver import FrameSolver, StoredFrame

ROUNDS: Final = 5
FRAMES: Final = 20
"""Rounds, of which the quickest counts, and frames of each."""


def main(calibration: str, *images: str) -> None:
    """Print the processor time of a frame, the frames a second of one core, and the agreement of each frame."""
    numba.set_num_threads(1)
    known = api.load_calibration(calibration)
    solver = FrameSolver.of(known)
    frames = [StoredFrame(image, read_image(Path(image))) for image in images]
    height = np.empty(solver.shape, np.float32)
    for name, sigma in (("heights", None), ("heights and uncertainty", np.empty_like(height))):
        spent_ms = _spent_ms(solver, frames, height, sigma)
        rows, columns = solver.shape
        sys.stdout.write(f"{columns}x{rows}, {name}: {spent_ms:.1f} ms, {1e3 / spent_ms:.0f} frames a second\n")
    for image, frame in zip(images, frames, strict=True):
        solver.solve(frame, height)
        alone = api.reconstruct(image, known, force=True)
        off = np.abs(height - alone.height_um) / alone.sigma_um
        sys.stdout.write(f"{image}: {np.nanquantile(off, 0.9):.2f} standard uncertainties off, 90th percentile\n")


def _spent_ms(
    solver: FrameSolver, frames: list[StoredFrame], height: Float32Array, sigma: Float32Array | None
) -> float:
    """Return the processor time of a frame in the quickest round, ms."""
    solver.solve(frames[0], height, sigma)
    rounds = []
    for _ in range(ROUNDS):
        began_s = time.process_time()
        for number in range(FRAMES):
            solver.solve(frames[number % len(frames)], height, sigma)
        rounds.append(1e3 * (time.process_time() - began_s) / FRAMES)
    return min(rounds)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
