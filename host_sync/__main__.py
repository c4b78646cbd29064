"""`retrosync`: the workstation's command line.

Exit codes: 0 done, 1 partly done (what failed is named), 2 bad input, 3 connection.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from device.errors import DeviceError
from host_sync.calibration.full_calibration import Method
from host_sync.compile_notice import tell_of_compiling
from host_sync.errors import FrameSetError, HostError, SourceError
from host_sync.frame_set import load_frame_set
from host_sync.library import Library, default_library
from host_sync.offload.directory import DirectorySource
from host_sync.offload.pull import PullProgress, pull
from host_sync.picture_format import PictureFormat
from host_sync.reconstruction.detail_filter import DetailBand
from host_sync.video_command import video

DONE, PARTLY, BAD_INPUT, CONNECTION = 0, 1, 2, 3

app = App(
    name="retrosync",
    version=lambda: f"retrograph {version('retrograph')}",
    help="Fetch scans from a handheld, prove them, reconstruct their surfaces.",
    suppress_keyboard_interrupt=False,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    try:
        result = app(arguments, exit_on_error=False, print_error=True, result_action="return_value")
    except SourceError as error:
        return _complain(error, CONNECTION)
    except (DeviceError, HostError) as error:
        return _complain(error, BAD_INPUT)
    except CycloptsError:
        return BAD_INPUT  # it has said in its own words which argument is wrong
    except KeyboardInterrupt:
        return _complain("stopped: what was not finished is not there", 130)
    except BrokenPipeError:
        # Whoever read the output has gone: let the interpreter's last flush go nowhere too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    return int(result or DONE)


@app.command(name="pull")
def pull_command(source: Path, *, library: Path | None = None) -> int:
    """Copy every scan and calibration that the library lacks, and prove each by re-reading it.

    Parameters
    ----------
    source: A card, a mount or a folder that holds a device's store.
    library: Where to; ~/Retrograph when not given.
    """
    target = Library(library or default_library())
    console = Console()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), DownloadColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("pull", total=None)

        def show(state: PullProgress) -> None:
            progress.update(task, description=state.bundle_id, completed=state.done_bytes, total=state.total_bytes)

        report = pull(DirectorySource(source), target, show)
    sys.stdout.write(
        f"{len(report.copied)} copied and verified, {len(report.already_there)} already there: {target.root}\n"
    )
    for scan in report.without_calibration:
        sys.stdout.write(f"Note: scan {scan} has no calibration here.\n")
    for failure in report.failed:
        _complain(f"{failure.bundle_id}: {failure.reason}", PARTLY)
    return DONE if report.complete else PARTLY


@app.command
def reconstruct(
    *names: str,
    out: Path | None = None,
    library: Path | None = None,
    method: Annotated[Method | None, Parameter(help="Default: what the calibration's held-out balls prefer.")] = None,
    s_filter_um: float | None = None,
    l_filter_um: float | None = None,
) -> int:
    """Calibrate and reconstruct the scans of a FRAMESET.toml (with --out) or of a library (with --library).

    Parameters
    ----------
    names: The frame set's file and, after it, names of scans; or scans of the library. All scans when none is named.
    out: Folder for the results of a frame set.
    library: Folder of pulled scans; results go to <scan>/results/.
    s_filter_um: Also write the detail: nesting index of the Gaussian filter that takes away what is shorter.
    l_filter_um: Also write the detail: nesting index of the Gaussian filter that takes away what is longer.
    """
    band = None if s_filter_um is None and l_filter_um is None else DetailBand(s_filter_um, l_filter_um)
    if (out is None) == (library is None):
        raise FrameSetError("name either a frame set with --out DIR, or --library LIB")
    with _telling() as tell:
        if library is not None:
            return _reconstruct_library(Library(library), names, method, tell, band)
        if not names or out is None:
            raise FrameSetError("name the frame set's file: retrosync reconstruct FRAMESET.toml --out DIR")
        return _reconstruct_frame_set(Path(names[0]), out, names[1:], method, tell, band)


app.command(video)


def _reconstruct_frame_set(
    path: Path,
    out: Path,
    names: Sequence[str],
    method: Method | None,
    tell: Callable[[str], None],
    band: DetailBand | None,
) -> int:
    frame_set = load_frame_set(path)
    tell("loading compiled code")
    tell_of_compiling()
    from host_sync.reconstruction.frame_set_job import reconstruct_frame_set

    done, failures = reconstruct_frame_set(frame_set, out, method, names, tell, band)
    for failure in failures:
        _complain(f"{failure.name}: {failure.reason}", PARTLY)
    sys.stdout.write(f"{len(done)} of {len(done) + len(failures)} scans reconstructed into {out}\n")
    if failures and not done:
        return BAD_INPUT
    return PARTLY if failures else DONE


def _reconstruct_library(
    library: Library,
    names: Sequence[str],
    method: Method | None,
    tell: Callable[[str], None],
    band: DetailBand | None,
) -> int:
    listing = library.scans()
    scans = [library.find(name) for name in names] if names else list(listing.bundles)
    failed = [] if names else [f"{bundle.directory.name}: {bundle.reason}" for bundle in listing.damaged]
    if not scans and not failed:
        raise HostError(f"{library.root} holds no scans: pull some first")
    tell("loading compiled code")
    tell_of_compiling()
    from host_sync.reconstruction.library_job import LibraryJob

    job = LibraryJob(library, method, tell, band)
    done = 0
    for scan in scans:
        try:
            _, folder = job.run(scan)
        except (DeviceError, HostError) as error:
            failed.append(str(error))
        else:
            done += 1
            sys.stdout.write(f"{folder}\n")
    for reason in failed:
        _complain(reason, PARTLY)
    if failed and not done:
        return BAD_INPUT
    return PARTLY if failed else DONE


@app.command
def figures(
    name: str | None = None,
    *,
    out: Path,
    library: Path | None = None,
    formats: Annotated[tuple[PictureFormat, ...], Parameter(name="--format", consume_multiple=True)] = ("png",),
) -> int:
    """Draw a calibration as the paper does: reflectance maps, ambiguous colours, errors of a held-out ball.

    Parameters
    ----------
    name: The frame set's file; or, with --library, a calibration of it, the latest when none is named.
    out: Folder for the pictures.
    library: Folder of pulled calibrations.
    formats: Any of png, pdf, svg.
    """
    with _telling() as tell:
        tell("loading compiled code (the first run compiles it)")
        from host_sync.reconstruction.figures_job import frames_to_draw, write_figures

        frames = frames_to_draw(name, Library(library) if library is not None else None)
        written = write_figures(frames, out, formats, tell)
    for path in written:
        sys.stdout.write(f"{path}\n")
    return DONE


@contextmanager
def _telling() -> Iterator[Callable[[str], None]]:
    """A line that says what is being done and for how long."""
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=None)
        yield lambda words: progress.update(task, description=words)


def _complain(what: object, code: int) -> int:
    sys.stderr.write(f"retrosync: {what}\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
