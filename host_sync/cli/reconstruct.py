"""`retrosync reconstruct` and `retrosync paper-figures`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from device.errors import DeviceError
from host_sync.cli.calibrator import calibrator_for
from host_sync.cli.console import (
    BAD_INPUT,
    DONE,
    PARTLY,
    Folder,
    print_error,
    renamed,
    status_spinner,
    tell_of_compiling,
)
from host_sync.errors import FrameSetError, HostError
from host_sync.filters.detail import DetailBand
from host_sync.frames.frame_set import FrameSet, load_frame_set
from host_sync.library.library import Library
from host_sync.results.files import DetailName

PictureFormat = Literal["png", "pdf", "svg"]
MethodName = Literal["direct", "paper"]
"""Methods of reconstruction; defined here too because importing them loads the numerics."""


def reconstruct(
    *names: str,
    out: Folder | None = None,
    library: Folder | None = None,
    calibration: Path | None = None,
    method: Annotated[MethodName | None, Parameter(help="Default: the one with the smaller held-out error.")] = None,
    s_filter_um: float | None = None,
    l_filter_um: float | None = None,
    detail: DetailName = "shrunk",
    force: bool = False,
) -> int:
    """Calibrate and reconstruct the scans of a FRAMESET.toml (with --out) or of a library (with --library).

    Parameters
    ----------
    names
        The frame set's file, then names of scans; or scans of the library. All scans by default.
    out
        Folder for the results of a frame set.
    library
        Folder of pulled scans; results go to SCAN/results/.
    calibration
        File that `retrosync calibrate` wrote. By default the presses of the frame set, or the calibration of each scan,
        calibrate; the first time only: calibrations are kept in a cache.
    s_filter_um
        Also write the detail: nesting index of the Gaussian filter that removes shorter wavelengths.
    l_filter_um
        Also write the detail: nesting index of the Gaussian filter that removes longer wavelengths.
    detail
        Detail of heights, slopes and pictures: shrunk removes pixel noise, raw keeps it. The other
        height map is written too.
    force
        Also reconstruct scans that do not fit their calibration; result.json keeps the warning.
    """
    band = None if s_filter_um is None and l_filter_um is None else DetailBand(s_filter_um, l_filter_um)
    if (out is None) == (library is None):
        raise FrameSetError("name either a frame set with --out DIR, or --library LIB")
    with status_spinner() as tell:
        if library is not None:
            held = Library(library)
            return _reconstruct_library(held, names, calibration, method, tell, band, force=force, detail=detail)
        if not names or out is None:
            raise FrameSetError("name the frame set's file: retrosync reconstruct FRAMESET.toml --out DIR")
        frame_set = load_frame_set(Path(names[0]), calibrates=calibration is None)
        return _reconstruct_frame_set(
            frame_set, out, names[1:], calibration, method, tell, band, force=force, detail=detail
        )


def _reconstruct_frame_set(
    frame_set: FrameSet,
    out: Path,
    names: Sequence[str],
    calibration: Path | None,
    method: MethodName | None,
    tell: Callable[[str], None],
    band: DetailBand | None,
    *,
    force: bool,
    detail: DetailName,
) -> int:
    tell("loading compiled code")
    tell_of_compiling()
    from host_sync.reconstruction.from_frame_set import reconstruct_frame_set

    calibrator = calibrator_for(calibration, tell)
    done, failures = reconstruct_frame_set(
        frame_set, out, method, names, tell, band, force=force, detail=detail, calibrator=calibrator
    )
    for failure in failures:
        print_error(f"{failure.name}: {failure.reason}", PARTLY)
    for name, warnings in done.items():
        for warning in warnings:
            print_error(f"{name}: {warning}", PARTLY)
    sys.stdout.write(f"{len(done)} of {len(done) + len(failures)} scans reconstructed into {out}\n")
    if failures and not done:
        return BAD_INPUT
    return PARTLY if failures else DONE


def _reconstruct_library(
    library: Library,
    names: Sequence[str],
    calibration: Path | None,
    method: MethodName | None,
    tell: Callable[[str], None],
    band: DetailBand | None,
    *,
    force: bool,
    detail: DetailName,
) -> int:
    listing = library.scans()
    scans = [library.find(name) for name in names] if names else list(listing.bundles)
    failed = [] if names else [f"{bundle.directory.name}: {bundle.reason}" for bundle in listing.damaged]
    if not scans and not failed:
        raise HostError(f"{library.root} holds no scans: pull some first")
    tell("loading compiled code")
    tell_of_compiling()
    from host_sync.reconstruction.from_library import LibraryReconstructor

    calibrator = calibrator_for(calibration, tell)
    job = LibraryReconstructor(library, method, tell, band, force=force, detail=detail, calibrator=calibrator)
    done = 0
    for scan in scans:
        try:
            found, folder = job.run(scan)
        except (DeviceError, HostError) as error:
            failed.append(f"{scan.scan_id}: {error}")
        else:
            done += 1
            for warning in found.warnings:
                print_error(f"{scan.scan_id}: {warning}", PARTLY)
            sys.stdout.write(f"{folder}\n")
    for reason in failed:
        print_error(reason, PARTLY)
    if failed and not done:
        return BAD_INPUT
    return PARTLY if failed else DONE


def paper_figures(
    name: str | None = None,
    *,
    out: Path,
    library: Path | None = None,
    calibration: Path | None = None,
    formats: Annotated[tuple[PictureFormat, ...], Parameter(name="--format", consume_multiple=True)] = ("png",),
) -> int:
    """Draw the figures of the CVPR 2009 paper: reflectance maps, ambiguous colours, errors of a held-out ball.

    Parameters
    ----------
    name
        The frame set's file; or, with --library, a calibration of it, the latest by default.
    out
        Folder for the pictures.
    library
        Folder of pulled calibrations.
    calibration
        File that `retrosync calibrate` wrote from the same frames; spares the first of two calibrations.
    formats
        Any of png, pdf, svg.
    """
    with status_spinner() as tell:
        tell("loading compiled code")
        tell_of_compiling()
        from host_sync.evaluation.figures import frames_to_draw, write_figures

        frames = frames_to_draw(name, Library(library) if library is not None else None)
        known = calibrator_for(calibration, tell).named().calibration if calibration is not None else None
        written = write_figures(frames, out, formats, tell, calibration=known)
    for path in written:
        sys.stdout.write(f"{path}\n")
    return DONE


figures_by_old_name = renamed(paper_figures, old="figures", new="paper-figures")
