"""`retrosync`: the workstation's command line.

Exit codes: 0 done, 1 partly done (what failed is named), 2 bad input, 3 connection.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, CycloptsError, Parameter

from device.ending_signals import ending_like_ctrl_c
from device.errors import DeviceError
from host_sync.commands import devices, exporting, gaging, measuring, offload, rendering, reporting, viewing
from host_sync.commands import library as library_commands
from host_sync.commands.console import BAD_INPUT, CONNECTION, DONE, PARTLY, Folder, complain, say, telling
from host_sync.compile_notice import tell_of_compiling
from host_sync.detail_band import DetailBand
from host_sync.errors import FrameSetError, HostError, SourceError
from host_sync.frame_set import load_frame_set
from host_sync.kernel_cache import keep_kernels_apart
from host_sync.library import Library
from host_sync.method_name import MethodName
from host_sync.picture_format import PictureFormat
from host_sync.video_command import video

if TYPE_CHECKING:
    from host_sync.calibration.full_calibration import Calibration

app = App(
    name="retrosync",
    version=lambda: f"retrograph {version('retrograph')}",
    help="Fetch scans from a handheld, prove them, reconstruct, measure and show their surfaces. "
    "Exit codes: 0 done, 1 partly done (what failed is named), 2 bad input, 3 connection, 130 stopped.",
    help_format="plaintext",
    default_parameter=Parameter(negative_iterable=()),
    suppress_keyboard_interrupt=False,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    keep_kernels_apart()
    try:
        with ending_like_ctrl_c(signal.SIGTERM):
            result = app(arguments, exit_on_error=False, print_error=True, result_action="return_value")
        sys.stdout.flush()
    except SourceError as error:
        return complain(error, CONNECTION)
    except (DeviceError, HostError) as error:
        return complain(error, BAD_INPUT)
    except CycloptsError:
        return BAD_INPUT  # it has said in its own words which argument is wrong
    except KeyboardInterrupt:
        return complain("stopped: what was not finished is not there", 130)
    except BrokenPipeError:
        _let_output_go()
        return 141
    except OSError as error:
        _let_output_go()
        return complain(f"the output cannot be written ({error.strerror or error}): redirect it elsewhere", PARTLY)
    return int(result or DONE)


def _let_output_go() -> None:
    """Whoever read the output has gone, or it is full: let the interpreter's last flush go nowhere too."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


offload.register(app)
devices.register(app)
library_commands.register(app)
exporting.register(app)
measuring.register(app)
gaging.register(app)
reporting.register(app)
viewing.register(app)
rendering.register(app)


@app.command
def reconstruct(
    *names: str,
    out: Folder | None = None,
    library: Folder | None = None,
    method: Annotated[MethodName | None, Parameter(help="Default: what the held-out balls prefer.")] = None,
    s_filter_um: float | None = None,
    l_filter_um: float | None = None,
    force: bool = False,
) -> int:
    """Calibrate and reconstruct the scans of a FRAMESET.toml (with --out) or of a library (with --library).

    Parameters
    ----------
    names
        The frame set's file and, after it, names of scans; or scans of the library. All scans when none is named.
    out
        Folder for the results of a frame set.
    library
        Folder of pulled scans; results go to SCAN/results/.
    s_filter_um
        Also write the detail: nesting index of the Gaussian filter that takes away what is shorter.
    l_filter_um
        Also write the detail: nesting index of the Gaussian filter that takes away what is longer.
    force
        Reconstruct scans too that were not made as their calibration was; result.json keeps the warning.
    """
    band = None if s_filter_um is None and l_filter_um is None else DetailBand(s_filter_um, l_filter_um)
    if (out is None) == (library is None):
        raise FrameSetError("name either a frame set with --out DIR, or --library LIB")
    with telling() as tell:
        if library is not None:
            return _reconstruct_library(Library(library), names, method, tell, band, force=force)
        if not names or out is None:
            raise FrameSetError("name the frame set's file: retrosync reconstruct FRAMESET.toml --out DIR")
        return _reconstruct_frame_set(Path(names[0]), out, names[1:], method, tell, band, force=force)


app.command(video)


def _reconstruct_frame_set(
    path: Path,
    out: Path,
    names: Sequence[str],
    method: MethodName | None,
    tell: Callable[[str], None],
    band: DetailBand | None,
    *,
    force: bool,
) -> int:
    frame_set = load_frame_set(path)
    tell("loading compiled code")
    tell_of_compiling()
    from host_sync.reconstruction.frame_set_job import reconstruct_frame_set

    done, failures = reconstruct_frame_set(
        frame_set, out, method, names, tell, band, force=force, calibrated=_say_calibration
    )
    for failure in failures:
        complain(f"{failure.name}: {failure.reason}", PARTLY)
    for name, warnings in done.items():
        for warning in warnings:
            complain(f"{name}: {warning}", PARTLY)
    sys.stdout.write(f"{len(done)} of {len(done) + len(failures)} scans reconstructed into {out}\n")
    if failures and not done:
        return BAD_INPUT
    return PARTLY if failures else DONE


def _say_calibration(calibration: Calibration) -> None:
    from host_sync.calibration.calibration_words import calibration_lines

    for line in calibration_lines(calibration):
        say(line)


def _reconstruct_library(
    library: Library,
    names: Sequence[str],
    method: MethodName | None,
    tell: Callable[[str], None],
    band: DetailBand | None,
    *,
    force: bool,
) -> int:
    listing = library.scans()
    scans = [library.find(name) for name in names] if names else list(listing.bundles)
    failed = [] if names else [f"{bundle.directory.name}: {bundle.reason}" for bundle in listing.damaged]
    if not scans and not failed:
        raise HostError(f"{library.root} holds no scans: pull some first")
    tell("loading compiled code")
    tell_of_compiling()
    from host_sync.reconstruction.library_job import LibraryJob

    job = LibraryJob(library, method, tell, band, force=force, calibrated=_say_calibration)
    done = 0
    for scan in scans:
        try:
            found, folder = job.run(scan)
        except (DeviceError, HostError) as error:
            failed.append(f"{scan.scan_id}: {error}")
        else:
            done += 1
            for warning in found.warnings:
                complain(f"{scan.scan_id}: {warning}", PARTLY)
            sys.stdout.write(f"{folder}\n")
    for reason in failed:
        complain(reason, PARTLY)
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
    name
        The frame set's file; or, with --library, a calibration of it, the latest when none is named.
    out
        Folder for the pictures.
    library
        Folder of pulled calibrations.
    formats
        Any of png, pdf, svg.
    """
    with telling() as tell:
        tell("loading compiled code")
        tell_of_compiling()
        from host_sync.reconstruction.figures_job import frames_to_draw, write_figures

        frames = frames_to_draw(name, Library(library) if library is not None else None)
        written = write_figures(frames, out, formats, tell)
    for path in written:
        sys.stdout.write(f"{path}\n")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
