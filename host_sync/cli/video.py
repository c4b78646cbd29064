"""`retrosync video` and `retrosync live`: heights of a recording or a running sensor (paper, section 6.2)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from device.command_line import Folder
from device.io.atomic import check_replaceable
from host_sync.cli.calibrate import obtain_calibration
from host_sync.cli.console import DONE, PARTLY, announce_compiling, print_error, print_line, progress, status_spinner
from host_sync.cli.reconstruct import MethodName
from host_sync.cli.view import serve_page
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set_file import Encoding
from host_sync.frames.sequence import BundleMovie, FrameSequence, open_sequence
from host_sync.library.library import Library
from host_sync.text import printable

if TYPE_CHECKING:
    from host_sync.video.reconstruct import SequenceReport


def video(
    sequence: Path,
    /,
    *,
    calibration: str | None = None,
    out: Path,
    library: Path | None = None,
    encoding: Encoding | None = None,
    rate_hz: float | None = None,
    method: MethodName | None = None,
    weighted: Annotated[bool, Parameter(negative="--no-weighted")] = True,
    mp4: Annotated[bool, Parameter(negative="--no-mp4")] = True,
    gif: Annotated[bool, Parameter(negative="--no-gif")] = True,
    sigma: bool = False,
    slip: bool = False,
    force: bool = False,
) -> int:
    """Reconstruct every frame of a sequence, draw the moving relief, and follow the contact.

    Parameters
    ----------
    sequence
        A folder of RGB images or raw frames in natural order, a recording of `retrosync live`, a TIFF of many pages, or
        an AVI, MP4, QuickTime or MKV movie; with --library also a scan with a movie of its press, by id, label's name
        or part.
    calibration
        A file of `retrosync calibrate`, a FRAMESET.toml or a calibration's folder; with --library, a calibration's id
        or its beginning or end. A scan's movie has its own by default.
    out
        Folder for heights_um.tif, relief.mp4, relief.gif, contact.csv and contact.png (largest depth, area and centre
        of the contact over time) and result.json. With the extra `movies` the MP4 plays in browsers; without it
        relief.webp does.
    library
        Folder of pulled scans and calibrations.
    encoding
        Encoding of light in the frames' values; that of the frame set by default.
    rate_hz
        Frames per second; that of the movie by default, else 25.
    method
        Method of reconstruction; the one with the smaller held-out error by default.
    weighted
        Weight each pixel by its confidence; without, all pixels count alike, which is faster.
    mp4
        Write the MP4.
    gif
        Write the GIF.
    sigma
        Also find the uncertainty of heights, for the ± of the contact's depth, area and centre.
    slip
        Also follow marks on the skin in the contact, with an error of up to 20 %; where it has none, its texture, up
        to half too short.
    force
        Also solve frames that do not fit the calibration.
    """
    if rate_hz is not None and not 1e-6 <= rate_hz <= 1e6:
        raise FrameSetError(f"--rate-hz {rate_hz:g} is not a rate: give frames per second, such as 25")
    frames, own = _opened(sequence, library)
    calibration = calibration or own
    if calibration is None:
        raise FrameSetError("--calibration is missing: only a scan's movie names its own")
    with progress("counts") as report_progress:
        announce_compiling()
        report_progress("loading compiled code")
        from host_sync.results.files import RECORD_FILE
        from host_sync.video.frame_solver import FrameSolver
        from host_sync.video.reconstruct import SequenceOptions, reconstruct_sequence

        check_replaceable(out, RECORD_FILE)  # before minutes of work
        kept = obtain_calibration(calibration, library, report_progress, paper=method == "paper")
        solver = FrameSolver.of(kept, method, encoding, weighted=weighted, force=force)
        names = printable(sequence.name), printable(calibration)
        order = SequenceOptions(printable(sequence.resolve().name), rate_hz, mp4, gif, sigma, slip, *names)
        report = reconstruct_sequence(frames, kept.calibration, solver, out, order, report_progress)
    return _print_report(report, out)


def _opened(sequence: Path, library: Path | None) -> tuple[FrameSequence, str | None]:
    """Return the frames, and the id of their own calibration where they are a scan's of the library."""
    if library is None or sequence.exists():
        return open_sequence(sequence), None
    bundle = Library(library).named(str(sequence))
    return BundleMovie(bundle), bundle.record.calibration_id


def _print_report(report: SequenceReport, out: Path) -> int:
    for failure in report.failures:
        print_error(failure.reason, PARTLY)
    for doubt in report.doubts:
        print_line(f"doubt: {doubt.sentence}")
    total = len(report.outcomes)
    drawn = f", {report.pictures_per_s:.1f} pictures/s" if report.pictures_per_s else ""
    done = total - len(report.failures)
    print_line(f"{done} of {total} frames into {out}: {report.heights_per_s:.1f} heights/s{drawn}")
    return PARTLY if report.failures else DONE


def live_command(
    source: str,
    /,
    *,
    calibration: str,
    library: Path | None = None,
    record: Folder = Path("recordings"),
    sigma: bool = False,
    encoding: Encoding | None = None,
    method: MethodName | None = None,
    force: bool = False,
    host: str = "127.0.0.1",
    port: int = 0,
    browser: Annotated[bool, Parameter(negative="--no-browser")] = True,
) -> int:
    """Show a sensor's heights live in a browser: relight, turn, follow the contact, record. Ctrl-C ends it.

    The newest frame is shown; frames that come while it is solved are dropped and counted. An unplugged sensor is
    looked for again.

    Parameters
    ----------
    source
        A board profile by name or file (digit, gelsight-mini, twin); a camera by its number or /dev/video file; or a
        recording, which is played in real time.
    calibration
        A file of `retrosync calibrate`, a FRAMESET.toml or a calibration's folder; with --library, a calibration's id
        or its beginning or end.
    library
        Folder of pulled calibrations.
    record
        Folder for recordings, which the key R starts and stops; `retrosync video` reconstructs their frames.
    sigma
        Also find the uncertainty of heights, for the ± of depth and area; about half as many pictures a second.
    encoding
        Encoding of light in the frames' values; that of the calibration by default.
    method
        Method of reconstruction; the one with the smaller held-out error by default.
    force
        Also show frames that do not fit the calibration.
    host
        Address to listen on. Beyond this machine the connection is not encrypted.
    port
        Port to listen on; a free one by default.
    browser
        Open the page in the desktop's browser.
    """
    with status_spinner() as report_progress:
        announce_compiling()
        report_progress("loading compiled code")
        from host_sync.video.frame_solver import FrameSolver
        from host_sync.video.reconstruct import sequence_doubts
        from host_sync.video.sensors import Recorder
        from host_sync.video.stream import open_live
        from host_sync.viewer.access import Access
        from host_sync.viewer.app import make_live_app
        from host_sync.viewer.live import LiveView
        from host_sync.viewer.serving import listening

        kept = obtain_calibration(calibration, library, report_progress, paper=method == "paper")
        solver = FrameSolver.of(kept, method, encoding, force=force)
        recorder = Recorder(record, printable(calibration))
        live = open_live(source, solver, newest=True, sigma=sigma, tap=recorder.take, report_progress=report_progress)
        doubts = tuple(doubt.sentence for doubt in sequence_doubts(kept.calibration, solver))
        view = LiveView(printable(source), live, recorder, solver, doubts)
    try:
        view.start()
        with listening(host, port) as listeners:
            access = Access(host, listeners[0].getsockname()[1])
            serve_page(make_live_app(view, access), listeners, access, browser=browser)
    finally:
        view.close()
    return DONE
