"""`retrosync export`: exports a scan or its result for other programs."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, cast, get_args

from cyclopts import Parameter

from device.bundles.scan import SCAN_MANIFEST
from device.command_line import Folder
from device.errors import DeviceError
from host_sync.cli.console import BAD_INPUT, DONE, PARTLY, print_error, print_line
from host_sync.errors import ExportError, HostError
from host_sync.export.array_formats import LineUm
from host_sync.export.raw_scan import RawFormat, export_raw
from host_sync.export.surface_export import FORMATS, ExportChoices
from host_sync.library.library import Library, default_library

RAW: Final = get_args(RawFormat)
SIGMA_HELP: Final = (
    "Also write the standard uncertainty of the height as NAME.sigma.FORM, for formats that hold one surface a file: "
    f"{' '.join(name for name, form in FORMATS.items() if form.one_layer)}. gwy, tiff, npz and csv always hold it with "
    "the heights."
)

if TYPE_CHECKING:
    ExportFormat = str
else:
    ExportFormat = Literal[tuple(dict.fromkeys((*RAW, *FORMATS)))]


def export_command(
    *sources: str,
    to: Annotated[tuple[ExportFormat, ...], Parameter(consume_multiple=True)],
    out: Folder,
    library: Folder | None = None,
    mesh_step: int | None = None,
    base_mm: float | None = None,
    line_um: LineUm | None = None,
    sigma: Annotated[bool, Parameter(help=SIGMA_HELP)] = False,
    semicolon: bool = False,
    overwrite: bool = False,
) -> int:
    """Export a result's surface, or the raw frame of a scan, for other programs.

    Parameters
    ----------
    sources
        Folders that reconstruct wrote, or GelSight TMD files; or, for the newest result of each, scans by id (or its
        beginning or end), by part, or by the name that `retrosync list SCAN --set-name` gave.
    to
        csv holds a profile; ply, stl, obj and glb are meshes. For a scan, dng and tiff hold its raw frame, the
        sensor's own counts.
    out
        Folder for the files.
    library
        Folder of the library; ~/Retrograph by default.
    mesh_step
        Row and column step of meshes.
    base_mm
        Thickness of a base that makes an STL watertight, for printing; open by default.
    line_um
        Start column, start row, end column, end row of the profile, from the centre of the first pixel; the
        middle row when not given.
    semicolon
        Write csv with semicolons and decimal commas, for spreadsheets of languages with a decimal comma.
    overwrite
        Replace files of the same name, though never those of another source of the same command.
    """
    if not sources:
        raise ExportError("name what to export: a result's folder, a TMD file, or a scan")
    choices = ExportChoices(mesh_step, line_um, overwrite, base_mm, sigma, semicolon)
    failures: list[str] = []
    done = 0
    for source in sources:
        written, refused = _export_one(source, tuple(dict.fromkeys(to)), out, library, choices)
        failures += [words if len(sources) == 1 else f"{source}: {words}" for words in refused]
        choices = replace(choices, reserved=choices.reserved | set(written))
        done += len(written)
        for path in written:
            print_line(str(path))
    code = (PARTLY if done else BAD_INPUT) if failures else DONE
    for words in failures:
        print_error(words, code)
    return code


def _export_one(
    source: str,
    forms: tuple[ExportFormat, ...],
    out: Path,
    library: Path | None,
    choices: ExportChoices,
) -> tuple[list[Path], list[str]]:
    """Return the files of one source, and what is wrong with those that are not written."""
    try:
        return _written(source, forms, out, library, choices)
    except (DeviceError, HostError) as error:
        return [], [str(error)]


def _written(
    source: str,
    forms: tuple[ExportFormat, ...],
    out: Path,
    library: Path | None,
    choices: ExportChoices,
) -> tuple[list[Path], list[str]]:
    place = Path(source)
    held = None if os.sep in source or _is_surface(place) else Library(library or default_library())
    scan = held.named(source) if held else None
    raw = [cast(RawFormat, form) for form in forms if scan and form in RAW]
    of_surface = tuple(form for form in forms if form not in raw)
    written: list[Path] = []
    refused: list[str] = []
    if of_surface:
        try:
            place = held.newest_result(scan) if held and scan else place
            written, refused = _export_surface(place, of_surface, out, choices)
        except (DeviceError, HostError) as error:
            if not raw:
                raise
            refused.append(f"{', '.join(of_surface)}: {error}")
    if scan is None:
        return written, refused
    for form in raw:
        try:
            written.append(export_raw(scan, form, out, overwrite=choices.overwrite))
        except (DeviceError, HostError) as error:
            refused.append(f"{form}: {error}")
    return written, refused


def _export_surface(
    place: Path,
    forms: tuple[ExportFormat, ...],
    out: Path,
    choices: ExportChoices,
) -> tuple[list[Path], list[str]]:
    # Pillow and the writers are loaded here, so that other commands start without them.
    from host_sync.export.array_formats import read_tmd
    from host_sync.export.source_surface import read_surface
    from host_sync.export.surface_export import export_surface

    if "dng" in forms:
        raise ExportError(f"{place}: is a surface, and dng holds a raw frame: give the scan's id instead")
    surface = read_surface(place) if place.is_dir() else read_tmd(place)
    return export_surface(surface, forms, out, choices)


def _is_surface(place: Path) -> bool:
    """Return whether this is a file or a folder other than a scan; other names are looked up in the library."""
    try:
        return place.is_file() or (place.is_dir() and not (place / SCAN_MANIFEST).is_file())
    except OSError:
        return False
