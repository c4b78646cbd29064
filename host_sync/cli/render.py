"""`retrosync render`: draws pictures of results without a browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from device.command_line import Folder
from device.io.atomic import check_output
from host_sync.cli.console import BAD_INPUT, DONE, PARTLY, announce_compiling, print_error, print_line, progress
from host_sync.errors import HostError, RenderError

if TYPE_CHECKING:
    from device.surface import HeightMap
    from host_sync.render.still import Still
    from host_sync.viewer.entry import Entry


@Parameter(name="*")
@dataclass(frozen=True)
class Look:
    """Settings of the pictures.

    Attributes
    ----------
    width
        Width of each picture, px.
    azimuth
        Azimuth of the viewpoint, degrees counter-clockwise from the right edge; 270 is in front.
    elevation
        Elevation of the viewpoint above the plane, degrees; without azimuth and elevation, from straight above.
    field
        Field of view, degrees; 0 is orthographic, as in the paper.
    light_azimuth
        Degrees counter-clockwise from the right edge; 135 is the upper left.
    light_elevation
        Degrees above the plane.
    exaggeration
        Factor on heights; chosen for good contrast by default.
    colour
        By height, or white as in the paper.
    shadow
        Draw cast shadows.
    occlusion
        Darken places that see little of the sky (ambient occlusion).
    range_um
        Heights of the first and last colour. Default: the range of each picture, or of all on a contact sheet.
    """

    width: int = 1600
    azimuth: float | None = None
    elevation: float | None = None
    field: float = 0.0
    light_azimuth: float = 135.0
    light_elevation: float = 40.0
    exaggeration: float | None = None
    colour: Literal["height", "white"] = "height"
    shadow: bool = False
    occlusion: bool = False
    range_um: tuple[float, float] | None = None

    def still(self, *, turning: bool = False) -> Still:
        """Return the settings of the renderer."""
        from host_sync.render.still import Still, Viewpoint

        aslant = self.azimuth is not None or self.elevation is not None or turning
        usual = Viewpoint() if aslant else Viewpoint(azimuth_deg=270.0, elevation_deg=90.0)
        view = Viewpoint(
            usual.azimuth_deg if self.azimuth is None else self.azimuth,
            usual.elevation_deg if self.elevation is None else self.elevation,
            self.field,
        )
        return Still(
            columns=self.width,
            viewpoint=view if aslant or self.field != 0.0 else None,
            light_azimuth_deg=self.light_azimuth,
            light_elevation_deg=self.light_elevation,
            exaggeration=self.exaggeration,
            colour=self.colour,
            shadow=self.shadow,
            occlusion=self.occlusion,
            range_um=self.range_um,
        )


def render_command(
    *results: Folder,
    out: Path,
    look: Look | None = None,
    contact_sheet: bool = False,
    across: int = 4,
    turntable: bool = False,
    frames: Annotated[int, Parameter(help="Pictures of a turntable.")] = 120,
) -> int:
    """Draw reliefs as in the paper's figures: from above or from another viewpoint, under a chosen light.

    Parameters
    ----------
    results
        Results, folders with results in them, or libraries.
    out
        The picture (.png, .jpg, .tif); a folder for those of several; with --turntable an .mp4, .gif or .webp.
    contact_sheet
        Draw all on one sheet, with names.
    across
        Pictures per row of a contact sheet.
    turntable
        Draw a movie of one turn.
    """
    look = look or Look()
    if contact_sheet and turntable:
        raise RenderError("give either --contact-sheet or --turntable")
    if not 2 <= frames <= 5000 or not 1 <= across <= 40:
        raise RenderError("--frames must be 2 to 5000, --across 1 to 40")
    entries = _entries(results)
    still = look.still(turning=turntable)
    check_output(
        out if contact_sheet or (len(entries) == 1 and out.suffix) else out / "picture.png", makes_folders=True
    )
    announce_compiling()
    if contact_sheet:
        return _write_sheet(entries, still, across, out)
    if len(entries) == 1 and out.suffix:
        _draw_one(entries[0], still, out, frames if turntable else None)
        return DONE
    return _draw_all(entries, still, out, frames if turntable else None)


def _entries(results: tuple[Path, ...]) -> list[Entry]:
    """Return the entries in the named places, without duplicates.

    Raises
    ------
    HostError
        One of them holds nothing to draw.
    """
    from host_sync.viewer.catalogue import Catalogue, ListFilter

    if not results:
        raise RenderError("name a result, a folder of results or a library: retrosync render RESULT --out PICTURE.png")
    found: dict[str, Entry] = {}
    for place in results:
        listing = Catalogue(place).list(ListFilter())
        for words in listing.complaints:
            print_error(words, PARTLY)
        found |= {entry.key: entry for entry in listing.entries}
    if not found:
        raise RenderError(f"{results[0]}: holds nothing to draw: reconstruct its scans first")
    return list(found.values())


def _height(entry: Entry) -> HeightMap:
    from device.surface import HeightMap
    from host_sync.viewer.entry import Heights

    return HeightMap(Heights().read(entry, entry.pages // 2), entry.pitch_um)


def _draw_one(entry: Entry, still: Still, path: Path, frames: int | None) -> None:
    from host_sync.render.picture_file import write_any_picture
    from host_sync.render.still import render, write_turntable

    if frames is None:
        write_any_picture(path, render(_height(entry), still))
    else:
        with progress("counts") as show:
            write_turntable(path, _height(entry), still, frames, lambda done, total: show(entry.title, done, total))
    print_line(str(path))
    _print_doubts(entry)


def _print_doubts(entry: Entry) -> None:
    for doubt in entry.doubts:
        print_line(f"  doubt: {entry.title}: {doubt}")


def _draw_all(entries: list[Entry], still: Still, folder: Path, frames: int | None) -> int:
    from host_sync.render.picture_file import file_stems, make_folder

    make_folder(folder)
    suffix = ".png" if frames is None else ".mp4"
    failed = 0
    for entry, stem in zip(entries, file_stems([entry.title for entry in entries]), strict=True):
        try:
            _draw_one(entry, still, folder / f"{stem}{suffix}", frames)
        except HostError as error:
            failed += 1
            print_error(f"{entry.title}: {error}", PARTLY)
    if failed == len(entries):
        return BAD_INPUT
    return PARTLY if failed else DONE


def _write_sheet(entries: list[Entry], still: Still, across: int, path: Path) -> int:
    from dataclasses import replace

    from host_sync.render.picture_file import write_any_picture
    from host_sync.render.relief_sheet import CELL_PX, contact_sheet
    from host_sync.render.still import render
    from host_sync.results.record import doubtful

    range_um = still.range_um or _common_range(entries)
    small = replace(still, columns=CELL_PX, range_um=range_um)
    cells = []
    for entry in entries:
        try:
            picture = render(_height(entry), small)
        except HostError as error:
            print_error(f"{entry.title}: {error}", PARTLY)
            continue
        rows, columns = entry.shape
        size_mm = f"{columns * entry.pitch_um / 1e3:.3g} × {rows * entry.pitch_um / 1e3:.3g} mm"
        taken = entry.hit.taken[:16].replace("T", " ") if entry.hit else None
        facts = [doubtful(entry.doubts), taken, size_mm]
        cells.append((entry.title, ", ".join(fact for fact in facts if fact), picture))
    if not cells:
        return BAD_INPUT
    write_any_picture(path, contact_sheet(cells, across, range_um if still.colour == "height" else None))
    print_line(str(path))
    for entry in entries:
        _print_doubts(entry)
    return DONE if len(cells) == len(entries) else PARTLY


def _common_range(entries: list[Entry]) -> tuple[float, float]:
    """Return the lowest and highest height of all that can be read, µm."""
    from host_sync.render.shading import height_range_um

    ends = []
    for entry in entries:
        try:
            ends.append(height_range_um(_height(entry)))
        except HostError:
            continue  # what cannot be read is named when it is drawn
    return (min(low for low, _ in ends), max(high for _, high in ends)) if ends else (0.0, 1.0)
