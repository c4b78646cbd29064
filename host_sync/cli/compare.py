"""`retrosync compare` and `retrosync mosaic`: presses of one spot, and overlapping presses.

A result is also compared with another program's map of the same pixels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from device.command_line import Folder, print_json
from device.io.atomic import check_replaceable
from host_sync.cli.console import DONE, PARTLY, announce_compiling, print_error, print_line, status_spinner
from host_sync.cli.measure import result_folders
from host_sync.errors import ViewError
from host_sync.library.library import Library, default_library
from host_sync.mosaic.presses import MOSAIC_FILE
from host_sync.results.files import RECORD_FILE

if TYPE_CHECKING:
    from host_sync.mosaic.writing import MosaicRecord
    from host_sync.results.reader import ResultSurface
    from host_sync.same_spot.comparing import SameSpotRecord

LISTED: Final = 10
COVERAGE: Final = 2.0
"""± in the summary is so many standard uncertainties."""


def compare_command(
    first: str,
    second: str,
    /,
    *,
    out: Folder | None = None,
    library: Folder | None = None,
    near: tuple[float, float, float] | None = None,
    same_pixels: bool = False,
    json: bool = False,
) -> int:
    """Compare two presses of one spot, or a result with another program's map of the same pixels.

    For two presses it finds the object's place in the second one, subtracts, and lists significant changes or the
    detection limit. A surface file, or two maps with --same-pixels, is subtracted pixel by pixel.

    Parameters
    ----------
    first
        The earlier result: a folder that reconstruct wrote, or a scan of the library by id, label's name or part.
    second
        The later one; or a surface file of the same pixels, such as GelSight's TMD.
    out
        Folder for the difference, its σ, a picture and same_spot.json; without it only the summary is printed.
    library
        Folder of the library; ~/Retrograph by default.
    near
        Place of the object in the second press, if the search fails: mm down, mm right, degrees clockwise.
    same_pixels
        Subtract pixel by pixel: both maps are of one press.
    json
        Print same_spot.json, or the figures of the difference, instead of the summary.
    """
    if same_pixels or Path(first).is_file() or Path(second).is_file():
        if out is not None or near is not None:
            raise ViewError("--out and --near are for two presses: maps of the same pixels need no search")
        return _compare_pixels(first, second, library, json=json)
    folders = [_result(name, library) for name in (first, second)]
    if folders[0].resolve() == folders[1].resolve():
        raise ViewError(f"{first} and {second} are one result: name an earlier and a later press")
    if out is not None:
        check_replaceable(out, "same_spot.json")  # before the work
    with status_spinner() as report_progress:
        announce_compiling()
        report_progress("loading compiled code")
        from host_sync.results.reader import read_result
        from host_sync.same_spot.comparing import compared, write_comparison

        report_progress("reading both results")
        surfaces = [read_result(folder, samples=False) for folder in folders]
        report_progress("looking for the spot")
        comparison = compared(surfaces[0], surfaces[1], near)
        if out is not None:
            write_comparison(comparison, out)
    if json:
        print_json(comparison.record)
        return DONE
    for line in _summary(comparison.record):
        print_line(line)
    return DONE


def _compare_pixels(first: str, second: str, library: Path | None, *, json: bool) -> int:
    """Print how far two maps of the same pixels differ, a plane subtracted."""
    from host_sync.measurement.foreign_file import map_difference

    surface, reference = (_surface(name, library) for name in (first, second))
    found = map_difference(surface.height, reference.height)
    if json:
        doubts = [f"{one.record.name}: {doubt.sentence}" for one in (surface, reference) for doubt in one.doubts]
        print_json({"difference": found, "doubts": doubts})
        return DONE
    share = found.percent_of_depth
    of_depth = "" if share is None else f" = {share:.2f} % of the depth of {found.depth_um:.4g} µm"
    print_line(
        f"{surface.record.name} against {reference.record.name}: rms {found.rms_um:.4g} µm{of_depth}, mean "
        f"{found.mean_um:.4g} µm, over {found.compared:.0%} of the pixels, a plane taken off"
    )
    for one in (surface, reference):
        for doubt in one.doubts:
            print_line(f"{one.record.name}: {doubt.sentence}")
    return DONE


def _surface(name: str, library: Path | None) -> ResultSurface:
    """Read a surface file, a result folder, or the newest result of a scan."""
    from host_sync.measurement.foreign_file import read_foreign
    from host_sync.results.reader import read_result

    path = Path(name)
    return read_foreign(path) if path.is_file() else read_result(_result(name, library))


def _result(name: str, library: Path | None) -> Path:
    folder = Path(name)
    if (folder / RECORD_FILE).is_file():
        return folder
    held = Library(library or default_library())
    held.require()
    return held.newest_result(held.named(name))


def _summary(record: SameSpotRecord) -> Iterator[str]:
    down, right = (1e-3 * part for part in record.shift_um)
    sigma = record.shift_sigma_um
    about = "" if sigma is None else f" ± {COVERAGE * sigma:.2g} µm"
    yield (
        f"{record.second}: the object lies {right:+.3f} mm right and {down:+.3f} mm down of where it lay in "
        f"{record.first}{about}, turned by {record.turn_deg:+.2f}°; {record.overlap_share:.0%} in common"
    )
    stated = record.height_sigma_median_um
    of_sigma = "" if stated is None else f"; its standard uncertainty {stated:.3g} µm in the median"
    yield f"difference: rms {record.residual_um:.3g} µm{of_sigma}"
    for one in record.changes[:LISTED]:
        yield (
            f"changed: {one.height_um:+.2f} µm ± {COVERAGE * one.sigma_um:.2f} µm "
            f"at {1e-3 * one.column_um:.2f} mm right, {1e-3 * one.row_um:.2f} mm down, "
            f"{1e-3 * one.diameter_um:.2g} mm across"
        )
    if len(record.changes) > LISTED:
        yield f"and {len(record.changes) - LISTED} changes more: --json lists them"
    if not record.limits:
        yield "nothing can be judged: the common field is too small or has too many holes"
    else:
        limits = ", ".join(f"{one.height_um:.2g} µm if {1e-3 * one.diameter_um:.2g} mm across" for one in record.limits)
        more = "no other change" if record.changes else "no change"
        yield f"{more} at this spot beyond {limits}; {record.judged_share:.0%} of the field judged"
    for warning in record.warnings:
        yield f"DOUBTFUL: {warning}"


def mosaic_command(
    *scans: Path,
    out: Folder,
    library: Folder | None = None,
    layout: Path | None = None,
    within_mm: float = 3.0,
    json: bool = False,
) -> int:
    """Stitch overlapping presses of one object into one height map, for measure, view, report and export.

    Exit code 1 means that presses were left out: no overlap joins them to the others, they have no results, or those
    cannot be read.

    Parameters
    ----------
    scans
        Folders that reconstruct wrote, or folders of such folders. With --library, scans of it; all by default.
    out
        Folder for the mosaic; mosaic.json in it lists every overlap, used or rejected.
    library
        Folder of pulled scans, each with its newest results.
    layout
        CSV file of the presses' places, with the columns scan, right_mm, down_mm; without it every pair is compared.
    within_mm
        Largest error of the layout.
    json
        Print mosaic.json instead of the summary.
    """
    folders: list[Path] = []
    left_out: list[str] = []
    for found in result_folders(scans, library):
        if isinstance(found, str):
            left_out.append(found)
            continue
        if (found / MOSAIC_FILE).is_file() and found not in scans and not (library and scans):
            continue  # an earlier mosaic beside its presses
        if found.resolve() in (folder.resolve() for folder in folders):
            left_out.append(f"{found}: is named twice")
            continue
        folders.append(found)
    check_replaceable(out, RECORD_FILE)  # before minutes of work
    with status_spinner() as report_progress:
        announce_compiling()
        report_progress("loading compiled code")
        from host_sync.mosaic.links import read_layout
        from host_sync.mosaic.presses import check_together, presses_of
        from host_sync.mosaic.stitch import stitch
        from host_sync.results.doubts import record_doubts
        from host_sync.results.record import read_record

        presses = presses_of(folders, out, library, left_out)
        check_together(presses, left_out)
        known = None if layout is None else read_layout(layout, presses, within_mm)
        record = stitch(presses, out, layout=known, left_out=left_out, report_progress=report_progress)
    for sentence in record.unusable:
        print_error(f"left out: {sentence}", PARTLY)
    if json:
        print_json(record)
    else:
        doubts = [doubt.reason for doubt in record_doubts(read_record(out)) if doubt.kind != "no zero"]
        for line in _mosaic_summary(record, out, doubts):
            print_line(line)
    return PARTLY if record.left_out or record.unusable else DONE


def _mosaic_summary(record: MosaicRecord, out: Path, doubts: Sequence[str]) -> Iterator[str]:
    overlaps = len(record.used)
    yield f"{out}: {len(record.presses)} presses, {overlaps} overlap{'' if overlaps == 1 else 's'}"
    for link in record.rejected:
        yield f"rejected: {link.first} and {link.second}: {link.rejected}"
    seams = [link for link in record.used if link.seam_sigmas is not None]
    if seams:
        worst = max(seams, key=lambda link: link.seam_sigmas or 0.0)
        yield (
            f"seams: at most {worst.seam_sigmas:.2g} σ ({worst.seam_um:.3g} µm, rms, between {worst.first} and "
            f"{worst.second})"
        )
    if record.stretch_median is not None:
        yield f"stretch between presses: {100.0 * record.stretch_median:+.3f} % in the median of all overlaps"
    yield (
        f"span {record.span_um * 1e-3:.3f} mm ± {2.0 * record.span_sigma_um * 1e-3:.3f} mm from the overlaps; "
        "the uncertainty of the pixel pitch adds to it"
    )
    for words in doubts:
        yield f"DOUBTFUL: {words}"
