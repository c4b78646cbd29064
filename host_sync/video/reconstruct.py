"""Reconstructs a sequence: heights of every frame, then the movie of the relief.

Three things run at the same time: a thread decodes frames ahead, others solve several (`stream`), a thread writes
earlier ones. Few frames wait for each of them, so memory does not grow with the sequence.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np
import tifffile

from device.io.atomic import atomic_directory
from device.surface import Float32Array, HeightMap
from host_sync.calibration.calibrate import Calibration
from host_sync.errors import SequenceError
from host_sync.frames.sequence import DEFAULT_RATE_HZ, BadFrame, FrameSequence, StoredFrame
from host_sync.reconstruction.result_writer import calibration_facts
from host_sync.render.picture_file import plays_in_browser
from host_sync.results.doubts import record_doubts
from host_sync.results.files import HEIGHTS_FILE, RECORD_FILE
from host_sync.results.record import Doubt, ResultRecord, SequenceFrame, SequenceRecord, doubtful, encode_record
from host_sync.video.contact import ContactRow, SlipTracker, draw_contact_chart, write_contact_table
from host_sync.video.fine_pass import CELLS_ACROSS
from host_sync.video.frame_solver import FrameSolver, FrameStatistics
from host_sync.video.movie import MovieFiles, Progress, RenderedRelief, write_movie
from host_sync.video.stream import FrameStream, SolvedFrame

QUEUE_LENGTH: Final = 3
"""Frames decoded before they are solved, and heights solved before they are written."""

CONTACT_FILE: Final = "contact.csv"
CONTACT_CHART: Final = "contact.png"


@dataclass(frozen=True, slots=True)
class FrameOutcome:
    """One frame of the sequence: its statistics, or the reason why it has none."""

    name: str
    statistics: FrameStatistics | None
    reason: str | None
    time_s: float


@dataclass(frozen=True, slots=True)
class SequenceReport:
    """Outcome of a sequence.

    heights_per_s, pictures_per_s : frames per second from file to height on disk, and from there to the movie
    doubts : reasons to distrust all heights
    """

    outcomes: tuple[FrameOutcome, ...]
    rate_hz: float
    heights_per_s: float
    pictures_per_s: float | None
    doubts: tuple[Doubt, ...] = ()

    @property
    def failures(self) -> tuple[FrameOutcome, ...]:
        """Frames without a height map."""
        return tuple(outcome for outcome in self.outcomes if outcome.statistics is None)


@dataclass(frozen=True, slots=True)
class SequenceOptions:
    """Options for a sequence.

    name : for titles and the record
    rate_hz : frames per second; None for the rate of the source, else `DEFAULT_RATE_HZ`
    mp4, gif : which movies to write
    sigma : also find the uncertainty of every frame, for the contact's ±
    slip : follow the skin's texture inside the contact
    sequence, calibration : names of what was reconstructed and with what, for the record
    """

    name: str
    rate_hz: float | None = None
    mp4: bool = True
    gif: bool = True
    sigma: bool = False
    slip: bool = False
    sequence: str = ""
    calibration: str = ""


COARSE_LIGHT: Final = (
    f"light was corrected on {CELLS_ACROSS} cells across the field: heights next to edges may differ from those of the "
    "frame reconstructed alone by several times their ±"
)


def sequence_doubts(calibration: Calibration, solver: FrameSolver) -> tuple[Doubt, ...]:
    """Return the doubts of every frame."""
    rows, columns = solver.shape
    record = ResultRecord(
        name="", rows=rows, columns=columns, pixel_pitch_um=calibration.pitch_um, **calibration_facts(calibration)
    )
    found = list(record_doubts(record))
    if solver.is_coarse:
        found.append(Doubt("reconstruction", COARSE_LIGHT))
    if solver.force:
        found.append(Doubt("frame unlike calibration", "frames that do not fit the calibration were solved too"))
    return tuple(found)


def reconstruct_sequence(
    sequence: FrameSequence,
    calibration: Calibration,
    solver: FrameSolver,
    out: Path,
    options: SequenceOptions,
    progress: Progress = lambda _step, _done, _all: None,
) -> SequenceReport:
    """Write heights, movies and `result.json` of a sequence to the directory `out`, completely or not at all.

    progress : called with the step, frames done and frames in total

    Raises
    ------
    SequenceError
        None of the frames could be reconstructed.
    OutputError
        The directory cannot be written; its previous contents are unchanged.
    """
    rate_hz = options.rate_hz or sequence.rate_hz or DEFAULT_RATE_HZ
    with atomic_directory(out, RECORD_FILE) as folder:
        relief = RenderedRelief()
        doubts = sequence_doubts(calibration, solver)
        began = time.perf_counter()
        with HeightStack(folder / HEIGHTS_FILE, solver.shape, sequence.count, calibration.pitch_um, rate_hz) as stack:
            outcomes, contacts = _solve_all(sequence, solver, stack, relief, rate_hz, options, progress)
        solved = time.perf_counter()
        if all(outcome.statistics is None for outcome in outcomes):
            raise SequenceError(f"none of {len(outcomes)} frames could be reconstructed: {outcomes[0].reason}")
        write_contact_table(folder / CONTACT_FILE, contacts)
        draw_contact_chart(folder / CONTACT_CHART, contacts, options.name)
        mp4 = folder / "relief.mp4" if options.mp4 else None
        webp = folder / "relief.webp" if options.mp4 and not plays_in_browser() else None
        movies = MovieFiles(mp4, folder / "relief.gif" if options.gif else None, webp)
        if movies.wanted:
            heights = open_heights(folder / HEIGHTS_FILE)
            title = f"{doubtful(doubts)} {options.name}".lstrip()
            write_movie(movies, heights, calibration.pitch_um, rate_hz, relief, title, progress)
        heights_per_s = len(outcomes) / (solved - began)
        pictures_per_s = len(outcomes) / (time.perf_counter() - solved) if movies.wanted else None
        report = SequenceReport(tuple(outcomes), rate_hz, heights_per_s, pictures_per_s, doubts)
        record = sequence_record(report, calibration, solver, relief, options)
        (folder / RECORD_FILE).write_bytes(encode_record(record))
    return report


def _solve_all(
    sequence: FrameSequence, solver: FrameSolver, stack: HeightStack, relief: RenderedRelief,
    rate_hz: float, options: SequenceOptions, progress: Progress,
) -> tuple[list[FrameOutcome], list[ContactRow]]:  # fmt: skip
    """Solve every frame and write its heights to the stack; returns their outcomes and contacts."""
    outcomes: list[FrameOutcome] = []
    contacts: list[ContactRow] = []
    writing: deque[Future[None]] = deque()
    slip = SlipTracker() if options.slip else None
    began_ns: int | None = None

    def write(solved: SolvedFrame, time_s: float) -> None:
        stack.append(solved.height_um)
        if solved.statistics is not None:
            relief.add(HeightMap(solved.height_um, solver.pitch_um))
        contacts.append(ContactRow.of(solved, time_s, solver.pitch_um, slip))

    with (
        FrameStream(solver, sigma=options.sigma) as stream,
        ThreadPoolExecutor(1) as reading,
        ThreadPoolExecutor(1) as disk,
    ):
        for solved in stream.solve(_decode_ahead(sequence, reading)):
            if len(writing) == QUEUE_LENGTH:
                writing.popleft().result()
            taken_ns = solved.frame.taken_ns
            time_s = solved.number / rate_hz
            if taken_ns is not None and options.rate_hz is None:
                began_ns = taken_ns if began_ns is None else began_ns
                time_s = (taken_ns - began_ns) * 1e-9
            outcomes.append(FrameOutcome(solved.name, solved.statistics, solved.reason, time_s))
            writing.append(disk.submit(write, solved, time_s))
            progress("heights", len(outcomes), sequence.count)
        for job in writing:
            job.result()
    return outcomes, contacts


def _decode_ahead(sequence: FrameSequence, reading: ThreadPoolExecutor) -> Iterator[StoredFrame | BadFrame]:
    """Yield the frames, up to `QUEUE_LENGTH` of them decoded in advance."""
    frames = sequence.frames()
    jobs = deque(reading.submit(next, frames, None) for _ in range(QUEUE_LENGTH))
    while (frame := jobs.popleft().result()) is not None:
        jobs.append(reading.submit(next, frames, None))
        yield frame


def sequence_record(
    report: SequenceReport,
    calibration: Calibration,
    solver: FrameSolver,
    relief: RenderedRelief,
    options: SequenceOptions,
) -> SequenceRecord:
    """Return contents of `result.json`."""
    rows, columns = solver.shape
    return SequenceRecord(
        name=options.name,
        program=f"retrograph {version('retrograph')}",
        written_utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        calibration_id=calibration.calibration_id,
        rows=rows,
        columns=columns,
        pixel_pitch_um=calibration.pitch_um,
        rate_hz=report.rate_hz,
        heights=f"{HEIGHTS_FILE}: a page per frame, µm, NaN is invalid",
        height_zero="median of untouched skin, in every frame",
        colour_range_um=(relief.low_um, relief.high_um),
        heights_per_s=report.heights_per_s,
        pictures_per_s=report.pictures_per_s,
        method=solver.method,
        encoding=solver.encoding,
        weighted=solver.weighted,
        forced=solver.force,
        sequence=options.sequence,
        calibration=options.calibration,
        doubts=report.doubts,
        frames=tuple(_frame_record(page, outcome) for page, outcome in enumerate(report.outcomes)),
    )


def _frame_record(page: int, outcome: FrameOutcome) -> SequenceFrame:
    figures = outcome.statistics
    if figures is None:
        return SequenceFrame(page=page, name=outcome.name, time_s=outcome.time_s, failed=outcome.reason or "")
    return SequenceFrame(
        page=page,
        name=outcome.name,
        time_s=outcome.time_s,
        contact_share=figures.contact_fraction,
        clipped_share=figures.clipped_fraction,
        masked_share=figures.masked_fraction,
        peak_um=figures.peak_um,
    )


# Height maps of a sequence in one file.
#
# The file is a multi-page TIFF in strips, not compressed. ImageJ opens it as a time series with pitch and frame
# interval, `tifffile.imread` returns an array of shape (T, H, W), and `tifffile.memmap` reads single pages. ImageJ
# reads neither tiles nor BigTIFF, hence strips; only a stack larger than the 4 GB of a classic TIFF is written as
# BigTIFF, which tifffile and ImageJ's Bio-Formats plug-in read.

CLASSIC_BYTES: Final = 4 * 10**9


class HeightStack:
    """Writes height maps of one size; a context manager.

    Parameters
    ----------
    path : the file to write
    shape : (H, W)
    max_pages : maximum number of pages
    pitch_um : pixel pitch, µm
    rate_hz : frames per second
    """

    def __init__(self, path: Path, shape: tuple[int, int], max_pages: int, pitch_um: float, rate_hz: float) -> None:
        self._path = path
        self._shape = shape
        self._max_pages = max_pages
        self._per_um = 1.0 / pitch_um
        self._interval_s = 1.0 / rate_hz
        self._pages = 0
        self._writer = tifffile.TiffWriter(path, bigtiff=max_pages * shape[0] * shape[1] * 4 > CLASSIC_BYTES)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.close()
        if self._pages not in (0, self._max_pages):
            with tifffile.TiffFile(self._path, mode="r+") as tiff:
                tiff.pages.first.tags["ImageDescription"].overwrite(self._description(self._pages))

    def append(self, z_um: Float32Array) -> None:
        """Write the next page: float32 array of shape (H, W), µm, NaN where invalid.

        Raises
        ------
        OSError
            The disk refused the write.
        """
        self._writer.write(
            np.ascontiguousarray(z_um, np.float32),
            contiguous=True,
            photometric="minisblack",
            rowsperstrip=self._shape[0],
            resolution=(self._per_um, self._per_um),
            resolutionunit="NONE",
            description=self._description(self._max_pages) if self._pages == 0 else None,
            metadata=None,
        )
        self._pages += 1

    def _description(self, pages: int) -> str:
        """Return metadata for ImageJ: pages are frames, pixels are µm."""
        return (
            f"ImageJ=1.53t\nimages={pages}\nframes={pages}\nunit=um\nfinterval={self._interval_s:.9g}\n"
            f"fps={1.0 / self._interval_s:.9g}\nloop=false\n"
        )


def open_heights(path: Path) -> Float32Array:
    """Return the stack as a read-only array of shape (T, H, W), mapped from disk."""
    with tifffile.TiffFile(path) as tiff:
        first, count = tiff.pages.first, len(tiff.pages)
        rows, columns = first.shape
        offset = first.dataoffsets[0]
        order = tiff.byteorder
    return np.memmap(path, np.dtype(np.float32).newbyteorder(order), "r", offset, (count, rows, columns))
