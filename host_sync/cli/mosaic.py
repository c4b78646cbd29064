"""`retrosync mosaic`: overlapping presses stitched into one result."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from device.command_line import Folder, print_json
from device.io.atomic import check_replaceable
from host_sync.cli.console import DONE, PARTLY, print_error, print_line, status_spinner, tell_of_compiling
from host_sync.cli.measure import result_folders
from host_sync.mosaic.record import MOSAIC_FILE
from host_sync.results.files import RECORD_FILE

if TYPE_CHECKING:
    from host_sync.mosaic.record import MosaicRecord


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
    with status_spinner() as tell:
        tell_of_compiling()
        tell("loading compiled code")
        from host_sync.mosaic.overlaps import read_layout
        from host_sync.mosaic.presses import check_together, presses_of
        from host_sync.mosaic.stitch import stitch
        from host_sync.results.record import read_record

        presses = presses_of(folders, out, library, left_out)
        check_together(presses, left_out)
        known = None if layout is None else read_layout(layout, presses, within_mm)
        record = stitch(presses, out, layout=known, left_out=left_out, tell=tell)
    for sentence in record.unusable:
        print_error(f"left out: {sentence}", PARTLY)
    if json:
        print_json(record)
    else:
        for line in _summary(record, out, read_record(out).warnings):
            print_line(line)
    return PARTLY if record.left_out or record.unusable else DONE


def _summary(record: MosaicRecord, out: Path, doubts: Sequence[str]) -> Iterator[str]:
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
