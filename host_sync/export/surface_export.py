"""Exports a surface to files for other programs, each written atomically and replaced only on request."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeAlias

import numpy as np

from device.io.atomic import atomic_file
from device.io.system import explain_os_error
from host_sync.errors import ExportError
from host_sync.export.array_formats import LineUm, pixels_on_line
from host_sync.export.mesh import grid_mesh, solid
from host_sync.export.source_surface import SourceSurface, doubts_path

Writer: TypeAlias = Callable[[BinaryIO], None]


def check_free(paths: Iterable[Path]) -> None:
    """Check that none of the paths exists.

    Raises
    ------
    ExportError
        One exists; the message names the first.
    """
    for path in paths:
        if os.path.lexists(path):
            raise ExportError(f"{path}: exists already: add --overwrite or choose another folder")


def check_own(paths: Iterable[Path], reserved: Collection[Path]) -> None:
    """Check that none of the paths is a file of another source; names that differ in case only are the same.

    Raises
    ------
    ExportError
        One is; the message names the first.
    """
    taken = {str(path).casefold() for path in reserved}
    for path in paths:
        if str(path).casefold() in taken:
            raise ExportError(
                f"{path}: is already the file of another source of this command: export into another folder"
            )


def publish(path: Path, write: Writer) -> None:
    """Write under a temporary name, then rename; creates the folder.

    Raises
    ------
    ExportError
        The folder cannot be written, or the writer failed; an existing file is unchanged.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as file:
            write(file)
    except ExportError:
        raise
    except OSError as error:
        # numpy reports a full disk by byte counts, without an error number.
        reason = explain_os_error(error) if error.errno else "(the disk is full): free space on it"
        raise ExportError(f"{path}: cannot be written {reason}") from error


def withdraw(path: Path) -> None:
    """Remove a file of an earlier export, if there is one.

    Raises
    ------
    ExportError
        It cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise ExportError(f"{path}: cannot be removed {explain_os_error(error)}") from error


MAX_NAME: Final = 120
"""Longest file name without suffix, bytes."""
PERMITTED: Final = "-_.+ "
DEVICE_NAMES: Final = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}


def export_surface(
    surface: SourceSurface, forms: Sequence[str], folder: Path, choices: ExportChoices
) -> tuple[list[Path], list[str]]:
    """Write files named after the surface into `folder`; returns their paths, and a sentence for each other format.

    Raises
    ------
    ExportError
        Nothing can be written: a file exists already, the line of the profile is not on the surface, or no format
        holds the surface.
    """
    stem = file_stem(surface.name)
    possible: dict[str, dict[Path, Writer]] = {}
    refused: dict[str, list[str]] = {}
    for form in dict.fromkeys(forms):
        try:
            possible[form] = {folder / f"{stem}{end}": write for end, write in _writers(surface, form, choices).items()}
        except ExportError as error:
            if form == "csv":
                raise
            refused.setdefault(str(error), []).append(form)
    files = [path for writers in possible.values() for path in writers]
    stale = {path: doubts_path(path) for path in files} if not surface.doubts else {}
    check_own(files, choices.reserved)
    if not choices.overwrite:
        check_free([*files, *sorted(stale.values())])
    written: list[Path] = []
    for form, writers in possible.items():
        try:
            for path, write in writers.items():
                publish(path, write)
                written.append(path)
                if path in stale:  # of a surface that was replaced
                    withdraw(stale[path])
        except ExportError as error:
            refused.setdefault(str(error), []).append(form)
    if refused and not written:
        raise ExportError("; ".join(refused))
    return written, [f"{', '.join(names)}: {words}" for words, names in refused.items()]


def file_stem(name: str) -> str:
    """Return a portable file name: letters, digits and a few signs, not hidden, without folders."""
    kept = "".join(letter if letter.isalnum() or letter in PERMITTED else "_" for letter in name)
    kept = kept.encode()[:MAX_NAME].decode(errors="ignore").strip(". ") or "height"
    return f"_{kept}" if kept.partition(".")[0].lower() in DEVICE_NAMES or kept.startswith("-") else kept


def _writers(surface: SourceSurface, name: str, choices: ExportChoices) -> dict[str, Writer]:
    """Return the suffix and writer of each file of a format, once options and sizes are checked."""
    form = FORMATS[name]
    suffix = f".{form.suffix or name}"
    options: tuple[Any, ...] = ()
    mesh = grid_mesh(surface, choices.mesh_step) if form.is_mesh else None
    if mesh:
        options = (surface.name, choices.base_mm) if name == "stl" else (surface.name,)
        if name == "stl" and choices.base_mm is not None:
            solid(mesh, choices.base_mm)  # refused before anything is written
    elif name == "csv":
        pixels_on_line(surface, choices.line_um)
        options = (choices.line_um, choices.semicolon)
    written = {suffix: (form.writer, mesh or surface, options)}
    if choices.sigma and form.one_layer:
        written[f".sigma{suffix}"] = (form.writer, _sigma_of(surface), ())
    writers: dict[str, Writer] = {}
    for of, (writer, subject, rest) in written.items():
        writers[of] = partial(_call, load(writer), subject, rest)
        if form.little_room and surface.doubts:
            writers[doubts_path(Path(of)).name] = partial(_write_doubts, surface)
    if form.side_writer:
        writers[f".{form.side_suffix}"] = partial(_call, load(form.side_writer), surface, ())
    return writers


def _call(write: Callable[..., None], subject: object, rest: tuple[Any, ...], file: BinaryIO) -> None:
    """Call a format's function."""
    write(file, subject, *rest)


def _sigma_of(surface: SourceSurface) -> SourceSurface:
    """Return the uncertainty as a surface of its own.

    Raises
    ------
    ExportError
        The result has none.
    """
    if surface.sigma_um is None or not np.isfinite(surface.sigma_um).any():
        raise ExportError(f"{surface.name}: has no uncertainty to export: reconstruct it with this version")
    what = "standard uncertainty of the height (k = 1)"
    return replace(
        surface,
        name=f"{surface.name}: sigma",
        z_um=surface.sigma_um,
        sigma_um=None,
        origin="; ".join(part for part in (what, surface.origin) if part),
    )


def _write_doubts(surface: SourceSurface, file: BinaryIO) -> None:
    """Write the doubts, one a line."""
    file.write("\n".join((surface.name, *surface.doubts, "")).encode())


# Formats and options of an export; a format is one declaration, and its writer is loaded when it writes.


@dataclass(frozen=True, slots=True)
class ExportChoices:
    """Options of an export.

    mesh_step : row and column step of meshes; None takes all pixels and refuses a field that is too large
    line_um : line of the CSV profile; None takes the middle row
    overwrite : replace files of the same name
    sigma : also write the uncertainty, as a file of its own, where a format has no place for it
    reserved : files that the same command wrote of another source, which are never replaced
    semicolon : write CSV for spreadsheets of languages with a decimal comma
    base_mm : thickness of a base that makes STL watertight; None leaves it open
    """

    mesh_step: int | None = None
    line_um: LineUm | None = None
    overwrite: bool = False
    base_mm: float | None = None
    sigma: bool = False
    semicolon: bool = False
    reserved: frozenset[Path] = frozenset()


@dataclass(frozen=True, slots=True)
class Format:
    """A file format of a surface.

    writer : module below this package and function, which takes the file, what is written, and options
    suffix : of the file; the format's name by default
    is_mesh : whether the function takes a `Mesh` and its name, not a `SourceSurface`
    one_layer : whether the file holds one surface, so that an uncertainty goes into a second file
    little_room : whether it holds no text of any length: doubts are marked there, and stand in a text file beside it
    side_writer, side_suffix : function and suffix of a second file that belongs to the first
    """

    writer: str
    suffix: str = ""
    is_mesh: bool = False
    one_layer: bool = False
    little_room: bool = False
    side_writer: str = ""
    side_suffix: str = ""


FORMATS: Final = {
    "gsf": Format("surface_formats:write_gsf", one_layer=True),
    "gwy": Format("surface_formats:write_gwy"),
    "x3p": Format("surface_formats:write_x3p", one_layer=True),
    "sur": Format("surface_formats:write_sur", one_layer=True),
    "sdf": Format("surface_formats:write_sdf", one_layer=True),
    "al3d": Format("surface_formats:write_al3d", one_layer=True, little_room=True),
    "tmd": Format("array_formats:write_tmd", one_layer=True, little_room=True),
    "tiff": Format("array_formats:write_float_tiff", suffix="tif"),
    "png": Format("array_formats:write_png16", side_writer="array_formats:write_png_scale", side_suffix="png.json"),
    "npz": Format("array_formats:write_npz"),
    "csv": Format("array_formats:write_csv_profile"),
    "ply": Format("mesh:write_ply", is_mesh=True),
    "stl": Format("mesh:write_stl", is_mesh=True, little_room=True),
    "obj": Format("mesh:write_obj", is_mesh=True),
    "glb": Format("mesh:write_glb", is_mesh=True),
}


def load(writer: str) -> Callable[..., None]:
    """Return the function that a format names."""
    module, _, function = writer.partition(":")
    loaded: Callable[..., None] = getattr(import_module(f"host_sync.export.{module}"), function)
    return loaded
