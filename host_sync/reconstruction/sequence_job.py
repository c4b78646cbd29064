"""Reconstructs a sequence: heights of every frame, then the moving relief.

Three things go on at a time: a thread decodes the frames ahead, a crew solves several (`frame_crew`), a thread writes
those before. Heights travel in arrays made once, so that memory does not grow with the sequence.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

import msgspec

from device.surface import Float32Array, HeightMap
from host_sync.calibration.full_calibration import Calibration
from host_sync.errors import SequenceError
from host_sync.frame_sequence import BadFrame, FrameSequence, StoredFrame
from host_sync.reconstruction.frame_crew import FrameCrew
from host_sync.reconstruction.frame_solver import FrameSolver
from host_sync.reconstruction.height_stack import HeightStack, open_heights
from host_sync.reconstruction.sequence_movie import MovieFiles, Progress, SeenRelief, write_movie
from host_sync.reconstruction.sequence_record import (
    DEFAULT_RATE_HZ,
    HEIGHTS_FILE,
    FrameOutcome,
    SequenceOrder,
    SequenceReport,
    sequence_record,
)
from host_sync.reconstruction.whole_directory import whole_directory

RECORD_FILE: Final = "result.json"
AHEAD: Final = 3
"""Frames decoded before they are solved, and heights solved before they are written."""


def reconstruct_sequence(
    sequence: FrameSequence,
    calibration: Calibration,
    solver: FrameSolver,
    out: Path,
    order: SequenceOrder,
    progress: Progress = lambda _step, _done, _all: None,
) -> SequenceReport:
    """Write heights, movies and `result.json` of a sequence to the directory `out`, whole or not at all.

    progress : is given the step, and how many frames of how many are done

    Raises
    ------
    SequenceError
        None of the frames could be reconstructed.
    ResultError
        The place cannot be written; what stood there stands.
    """
    rate_hz = order.rate_hz or sequence.rate_hz or DEFAULT_RATE_HZ
    with whole_directory(out, RECORD_FILE) as folder:
        seen = SeenRelief()
        began = time.perf_counter()
        with HeightStack(folder / HEIGHTS_FILE, solver.shape, sequence.count, calibration.pitch_um, rate_hz) as stack:
            outcomes = _solve_all(sequence, solver, stack, seen, calibration.pitch_um, progress)
        solved = time.perf_counter()
        if all(outcome.figures is None for outcome in outcomes):
            raise SequenceError(f"none of {len(outcomes)} frames could be reconstructed: {outcomes[0].reason}")
        movies = MovieFiles(folder / "relief.mp4" if order.mp4 else None, folder / "relief.gif" if order.gif else None)
        if movies.wanted:
            heights = open_heights(folder / HEIGHTS_FILE)
            write_movie(movies, heights, calibration.pitch_um, rate_hz, seen, order.name, progress)
        heights_per_s = len(outcomes) / (solved - began)
        pictures_per_s = len(outcomes) / (time.perf_counter() - solved) if movies.wanted else None
        report = SequenceReport(tuple(outcomes), rate_hz, heights_per_s, pictures_per_s)
        record = sequence_record(report, calibration, solver, seen, order)
        (folder / RECORD_FILE).write_bytes(msgspec.json.format(msgspec.json.encode(record), indent=2))
    return report


def _solve_all(
    sequence: FrameSequence, solver: FrameSolver, stack: HeightStack, seen: SeenRelief, pitch_um: float,
    progress: Progress,
) -> list[FrameOutcome]:  # fmt: skip
    """Solve every frame and write its heights to the stack; what became of each."""
    outcomes: list[FrameOutcome] = []
    writing: deque[Future[None]] = deque()

    def write(z_um: Float32Array, solved: bool) -> None:
        try:
            stack.append(z_um)
            if solved:
                seen.add(HeightMap(z_um, pitch_um))
        finally:
            crew.give_back(z_um)

    with FrameCrew(solver, AHEAD) as crew, ThreadPoolExecutor(1) as reading, ThreadPoolExecutor(1) as disk:
        for outcome, z_um in crew.solved(_decoded_ahead(sequence, reading)):
            if len(writing) == AHEAD:
                writing.popleft().result()
            outcomes.append(outcome)
            writing.append(disk.submit(write, z_um, outcome.figures is not None))
            progress("heights", len(outcomes), sequence.count)
        for job in writing:
            job.result()
    return outcomes


def _decoded_ahead(sequence: FrameSequence, reading: ThreadPoolExecutor) -> Iterator[StoredFrame | BadFrame]:
    """The frames, up to `AHEAD` of them decoded in advance."""
    frames = sequence.frames()
    jobs = deque(reading.submit(next, frames, None) for _ in range(AHEAD))
    while (frame := jobs.popleft().result()) is not None:
        jobs.append(reading.submit(next, frames, None))
        yield frame
