"""`retrosync export`: a scan or its result for other programs; `retrosync import`: their folders as a frame set."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, cast, get_args

from cyclopts import Parameter

from device.bundles.scan import SCAN_MANIFEST
from device.command_line import Folder
from device.errors import DeviceError
from device.io.atomic import check_output
from host_sync.cli.console import BAD_INPUT, DONE, PARTLY, print_error, print_line, status_spinner
from host_sync.errors import ExportError, FrameSetError, HostError
from host_sync.export.array_formats import LineUm
from host_sync.export.raw_scan import RawFormat, export_raw
from host_sync.export.surface_export import FORMATS, ExportChoices
from host_sync.frames.frame_set_file import SET_FILE
from host_sync.library.library import Library, default_library

if TYPE_CHECKING:
    from host_sync.importers.draft import Draft, Said

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


Kind = Literal["gelsight", "gs_sdk", "py3dcal", "taxim", "fots", "digit", "images"]
"""As of `host_sync.importers.recognition`; defined here too because importing it loads the numerics."""

FIELD_TOLERANCE: Final = 0.05
"""The field's width as stated may be off by this fraction: the gel is thick, and streams are cropped."""


def import_command(
    *source: Path,
    kind: Kind | None = None,
    out: Folder | None = None,
    pixel_pitch_um: float | None = None,
    pixel_pitch_down_um: float | None = None,
    field_mm: float | None = None,
    ball_diameter_mm: float | None = None,
    ball_radius_mm: float | None = None,
    encoding: Literal["linear", "srgb"] | None = None,
    full_scale: int | None = None,
    reference: Path | None = None,
    results: Annotated[Folder | None, Parameter(help="Also calibrate and reconstruct: folder for the results.")] = None,
) -> int:
    """Describe another program's folder as a frame set, and show the balls that are found on a contact sheet.

    The folder is recognized by what it holds; its files stay as they are. At a terminal the command asks for
    what they do not state; elsewhere it names the missing option.

    Parameters
    ----------
    source
        The folder, optionally with its kind before it.
    kind
        gelsight: scan.yaml folders of the SDK and Mobile; gs_sdk: its calibration folder; py3dcal: its dataset; taxim:
        dataPack.npz with its images; fots: a table of circles, also of digit-depth; digit and images: a folder of RGB
        images. By default the folder's contents decide.
    out
        The frame set's file, or a folder for it; by default frameset.toml in the source's folder. The contact sheet
        goes next to it.
    pixel_pitch_um
        Distance of neighbouring pixels on the skin; overrides that of the files.
    pixel_pitch_down_um
        Distance of neighbouring pixels down a column, if pixels are not square; --pixel-pitch-um is then along a row.
    field_mm
        Width of the field on the skin, by a data sheet or a ruler, if the pixel pitch is not known; the pitch that
        follows from it has ± 5 %, which the ± of every height includes.
    ball_diameter_mm
        Diameter of the calibration ball; overrides that of the files.
    ball_radius_mm
        Radius of the calibration ball, instead of its diameter.
    encoding
        How pixel values encode light.
    full_scale
        Largest count of images of 16 bit, such as 4095 of a camera of 12 bit.
    reference
        The image of untouched skin, or for gelsight its scan's folder.
    """
    from host_sync.importers.draft import Said

    folder, kind = _folder_and_kind(source, kind)
    if pixel_pitch_um is not None and field_mm is not None:
        raise FrameSetError("--field-mm and --pixel-pitch-um state the same: give one of them")
    if ball_diameter_mm is not None and ball_radius_mm is not None:
        raise FrameSetError("--ball-diameter-mm and --ball-radius-mm state the same: give one of them")
    lengths = {
        "--pixel-pitch-um": pixel_pitch_um,
        "--pixel-pitch-down-um": pixel_pitch_down_um,
        "--field-mm": field_mm,
        "--ball-diameter-mm": ball_diameter_mm,
        "--ball-radius-mm": ball_radius_mm,
    }
    for name, value in lengths.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise FrameSetError(f"{name} {value:g}: is no length: give a positive number")
    if not folder.is_dir():
        raise FrameSetError(f"{folder}: is no folder: name the folder that the other program wrote")
    path = out or folder
    path = path if path.suffix == ".toml" else path / SET_FILE
    check_output(path, makes_folders=True)
    by_diameter = ball_diameter_mm is not None
    radius_mm = ball_radius_mm if ball_diameter_mm is None else 0.5 * ball_diameter_mm
    said = Said(pixel_pitch_um, radius_mm, encoding, reference, pixel_pitch_down_um, full_scale, by_diameter)
    draft = _described(folder, kind, said, field_mm)
    draft.write(path)
    _print_draft(draft, path)
    if draft.presses:
        _show_balls(path)
    if results is None:
        return DONE
    if not draft.presses:
        raise FrameSetError(
            f"{path}: no press calibrates: call the images of the ball ball-…, or reconstruct with --calibration FILE"
        )
    from host_sync.cli.reconstruct import reconstruct

    return reconstruct(str(path), out=results)


def _folder_and_kind(source: tuple[Path, ...], kind: Kind | None) -> tuple[Path, Kind | None]:
    """Return the folder, and the kind where it is named."""
    from host_sync.importers.recognition import IMPORTERS

    if len(source) == 2 and str(source[0]) in IMPORTERS:
        return source[1], next(known for known in IMPORTERS if known == str(source[0]))
    if len(source) != 1:
        raise FrameSetError(f"{len(source)} folders are named: name the one folder that the other program wrote")
    return source[0], kind


def _described(folder: Path, kind: Kind | None, said: Said, field_mm: float | None) -> Draft:
    """Return the draft of a folder; what is missing is asked for where somebody can answer.

    field_mm : width of the field, from which the pixel pitch follows; None where the pitch is known
    """
    from host_sync.importers.recognition import WRITTEN_BY, read_folder, recognize

    if kind is None:
        kind = recognize(folder)
        print_line(f"{folder}: {WRITTEN_BY[kind]}")
    with status_spinner() as report_progress:
        report_progress("looking at the images")
        draft = read_folder(folder, kind, said)
        if field_mm is not None:
            said = replace(said, pixel_pitch_um=draft.pitch_of_field_um(field_mm))
            draft = read_folder(folder, kind, said)
            draft = replace(draft, pitch_tolerance_um=FIELD_TOLERANCE * (said.pixel_pitch_um or 0.0))
    if not draft.missing() or not sys.stdin.isatty():
        return draft
    _print_draft(draft, folder)
    said = _answers(draft, said)
    return read_folder(folder, kind, said) if said.ball_radius_mm else _with_answers(draft, said)


def _answers(draft: Draft, said: Said) -> Said:
    """Return the answers of the user to the questions of a draft; an answer that is none is asked for again."""
    for option in draft.missing():
        if option.startswith("--pixel-pitch-um"):
            said = replace(said, pixel_pitch_um=_length("Distance of neighbouring pixels on the skin, µm"))
        elif option.startswith("--ball"):
            said = replace(said, ball_radius_mm=0.5 * _length("Diameter of the ball, mm"), states_diameter=True)
        else:
            answer = _ask("Are pixel values proportional to light (linear), or as screens show them (srgb)?")
            while answer not in ("linear", "srgb"):
                answer = _ask("linear or srgb?")
            said = replace(said, encoding="linear" if answer == "linear" else "srgb")
    return said


def _with_answers(draft: Draft, said: Said) -> Draft:
    return replace(
        draft,
        pixel_pitch_um=said.pixel_pitch_um or draft.pixel_pitch_um,
        encoding=said.encoding or draft.encoding,
    )


def _length(question: str) -> float:
    while True:
        answer = _ask(question).replace(",", ".")
        try:
            value = float(answer)
        except ValueError:
            continue
        if 0.0 < value < float("inf"):
            return value


def _ask(question: str) -> str:
    try:
        return input(f"{question}: ").strip()
    except EOFError as error:
        raise FrameSetError("the question was not answered: give the option instead") from error


def _print_draft(draft: Draft, path: Path) -> None:
    lights = f" of {len(draft.lights)} lights" if draft.lights else ""
    print_line(f"{path}: {len(draft.presses)} presses and {len(draft.scans)} scans{lights}")
    for note in draft.notes:
        print_line(f"Note: {note}.")
    if draft.reference:
        print_line(f"Untouched skin: {', '.join(image.name for image in draft.reference)}")
    else:
        print_line("No frame of untouched skin is known: name it with --reference, or it is estimated from the frames.")
    if not draft.presses:
        print_line("No press calibrates: reconstruct with --calibration FILE.")
    for scan in draft.scans:
        if scan.height_map is not None:
            print_line(f"{scan.name}: the maker's height map is {scan.height_map}")


def _show_balls(path: Path) -> None:
    """Draw the contact sheet of a frame set beside it, and print what it shows."""
    from host_sync.frames.frame_set import load_frame_set
    from host_sync.importers.recognition import write_contact_sheet

    with status_spinner() as report_progress:
        report_progress("finding balls")
        try:
            lines = write_contact_sheet(load_frame_set(path), path.with_name(f"{path.stem}-balls.png"))
        except (FrameSetError, KeyboardInterrupt):
            path.unlink()  # It would be in the way of the next try.
            raise
        except DeviceError as error:
            lines = (f"No contact sheet: {error}",)
    for line in lines:
        print_line(line)
