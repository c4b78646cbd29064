"""`retrosync video`: the moving surface under the gel (paper, section 6.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from device.calibration_bundle import read_calibration
from host_sync.commands.console import complain, say
from host_sync.compile_notice import tell_of_compiling
from host_sync.errors import FrameSetError
from host_sync.frame_sequence import open_sequence
from host_sync.frame_set import load_frame_set
from host_sync.frame_set_file import Encoding
from host_sync.library import Library
from host_sync.method_name import MethodName
from host_sync.plain_text import printable
from host_sync.reconstruction.whole_directory import check_replaceable

if TYPE_CHECKING:
    from host_sync.calibration.full_calibration import Calibration
    from host_sync.reconstruction.sequence_record import SequenceReport

DONE, PARTLY = 0, 1

Tell = Callable[[str, int | None, int | None], None]


def video(
    sequence: Path,
    *,
    calibration: str,
    out: Path,
    library: Path | None = None,
    encoding: Encoding | None = None,
    rate_hz: float | None = None,
    method: MethodName | None = None,
    weighted: bool = True,
    mp4: bool = True,
    gif: bool = True,
    force: bool = False,
) -> int:
    """Reconstruct every frame of a sequence and draw the moving relief.

    Parameters
    ----------
    sequence
        A folder of RGB images or raw frames in natural order, a TIFF of many pages, or an AVI, MP4 or MKV movie.
    calibration
        A FRAMESET.toml or a calibration's folder; with --library, a calibration's id or its beginning or end.
    out
        Folder for heights_um.tif, relief.mp4, relief.gif and result.json.
    library
        Folder of pulled scans and calibrations.
    encoding
        How the frames' values encode light; what the frame set says when not given.
    rate_hz
        Frames a second; what the movie says when not given, else 25.
    method
        What the calibration's held-out balls prefer when not given.
    weighted
        Trust each pixel as much as its colour deserves; without, every pixel alike, which is faster.
    mp4
        Write the MP4.
    gif
        Write the GIF.
    force
        Solve frames too that were not made as the calibration was.
    """
    if rate_hz is not None and not 1e-6 <= rate_hz <= 1e6:
        raise FrameSetError(f"--rate-hz {rate_hz:g} is no rate: give frames a second, such as 25")
    frames = open_sequence(sequence)
    with _telling() as tell:
        tell_of_compiling()
        tell("loading compiled code", None, None)
        from host_sync.reconstruction.frame_solver import FrameSolver
        from host_sync.reconstruction.sequence_job import RECORD_FILE, reconstruct_sequence
        from host_sync.reconstruction.sequence_record import SequenceOrder

        check_replaceable(out, RECORD_FILE)  # before minutes of work
        known, stated = _calibration(calibration, library, lambda words: tell(words, None, None))
        solver = FrameSolver(known, method or known.preferred, encoding or stated, weighted=weighted, force=force)
        facts = (("sequence", printable(sequence.name)), ("calibration", printable(calibration)))
        order = SequenceOrder(printable(sequence.resolve().name), rate_hz, mp4, gif, facts)
        report = reconstruct_sequence(frames, known, solver, out, order, tell)
    return _tell_report(report, out)


def _calibration(name: str, library: Path | None, tell: Callable[[str], None]) -> tuple[Calibration, Encoding | None]:
    """The calibration of that name, and how the frames of its frame set encode light.

    Raises
    ------
    HostError, DeviceError
        There is none, or it is damaged.
    """
    path = Path(name)
    if library is None and not path.is_dir():
        frame_set = load_frame_set(path)
        from host_sync.reconstruction.frame_set_job import calibrate_frame_set

        return calibrate_frame_set(frame_set, tell), frame_set.presses[0].frame.encoding
    bundle = Library(library).find_calibration(name) if library else read_calibration(path)
    from host_sync.reconstruction.library_job import calibration_of

    return calibration_of(bundle, tell), None


def _tell_report(report: SequenceReport, out: Path) -> int:
    for failure in report.failures:
        complain(failure.reason, PARTLY)
    total = len(report.outcomes)
    drawn = f", {report.pictures_per_s:.1f} pictures/s" if report.pictures_per_s else ""
    done = total - len(report.failures)
    say(f"{done} of {total} frames into {out}: {report.heights_per_s:.1f} heights/s{drawn}")
    return PARTLY if report.failures else DONE


@contextmanager
def _telling() -> Iterator[Tell]:
    """A line that says what is being done and how far it is, on a terminal only."""
    console = Console(stderr=True)
    words = TextColumn("{task.description}", markup=False)
    columns = (words, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=None)

        def tell(step: str, done: int | None, total: int | None) -> None:
            progress.update(task, description=step, completed=done or 0, total=total)

        yield tell
