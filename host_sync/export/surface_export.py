"""Exports a surface to files for other programs, each written atomically."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, Concatenate, Final, Literal, ParamSpec, cast, get_args

import numpy as np

from host_sync.errors import ExportError
from host_sync.export.array_formats import write_float_tiff, write_npz, write_png16, write_png_scale
from host_sync.export.choices import ExportChoices
from host_sync.export.csv_profile import pixels_on_line, write_csv_profile
from host_sync.export.gwy import write_gwy
from host_sync.export.mesh import Mesh, grid_mesh
from host_sync.export.mesh_formats import write_glb, write_obj, write_ply, write_stl
from host_sync.export.publishing import Writer, check_free, check_own, publish, withdraw
from host_sync.export.solid import solid
from host_sync.export.source_surface import SourceSurface, doubts_path
from host_sync.export.surface_formats import write_al3d, write_gsf, write_sdf, write_sur
from host_sync.export.tmd import write_tmd
from host_sync.export.x3p import write_x3p

FieldFormat = Literal["gsf", "gwy", "x3p", "sur", "sdf", "al3d", "tmd", "tiff", "png", "npz"]
MeshFormat = Literal["ply", "stl", "obj", "glb"]
SurfaceFormat = Literal[FieldFormat, MeshFormat, "csv"]
Rest = ParamSpec("Rest")

MAX_NAME: Final = 120
"""Longest file name without suffix, bytes."""
LITTLE_ROOM: Final = frozenset({"tmd", "stl", "al3d"})
"""Formats that hold no text of any length: doubts are marked there, and stand in a text file beside."""
ONE_LAYER: Final = frozenset({"gsf", "x3p", "sur", "sdf", "al3d", "tmd"})
"""Formats of one surface a file: an uncertainty goes into a second file."""

PERMITTED: Final = "-_.+ "
DEVICE_NAMES: Final = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}

_FIELDS: Final[dict[str, Callable[[BinaryIO, SourceSurface], None]]] = {
    "gsf": write_gsf,
    "gwy": write_gwy,
    "x3p": write_x3p,
    "sur": write_sur,
    "sdf": write_sdf,
    "al3d": write_al3d,
    "tmd": write_tmd,
    "tiff": write_float_tiff,
    "png": write_png16,
    "npz": write_npz,
}
_MESHES: Final[dict[str, Callable[[BinaryIO, Mesh, str], None]]] = {
    "ply": write_ply,
    "stl": write_stl,
    "obj": write_obj,
    "glb": write_glb,
}


def export_surface(
    surface: SourceSurface, forms: Sequence[SurfaceFormat], folder: Path, choices: ExportChoices
) -> tuple[Path, ...]:
    """Write files named after the surface into `folder`; returns their paths.

    Raises
    ------
    ExportError
        A format cannot hold the surface, a file exists already (nothing is written then), or the folder cannot be
        written.
    """
    stem = file_stem(surface.name)
    files = {folder / f"{stem}{suffix}": write for suffix, write in _writers(surface, forms, choices).items()}
    stale = set() if surface.doubts else {doubts_path(path) for path in files}
    check_own(files, choices.reserved)
    if not choices.overwrite:
        check_free([*files, *sorted(stale)])
    for path, write in files.items():
        publish(path, write)
    for path in stale:  # of a surface that was replaced
        withdraw(path)
    return tuple(files)


def without_refused(
    surface: SourceSurface, forms: Sequence[SurfaceFormat], choices: ExportChoices
) -> tuple[tuple[SurfaceFormat, ...], list[str]]:
    """The formats that can hold the surface, and a sentence for each other reason to refuse one.

    Raises
    ------
    ExportError
        The line of the profile is not on the surface: that is for the user to correct.
    """
    possible: list[SurfaceFormat] = []
    refused: dict[str, list[str]] = {}
    for form in dict.fromkeys(forms):
        try:
            _writers(surface, (form,), choices)
        except ExportError as error:
            if form == "csv":
                raise
            refused.setdefault(str(error), []).append(form)
        else:
            possible.append(form)
    return tuple(possible), [f"{', '.join(names)}: {words}" for words, names in refused.items()]


def file_stem(name: str) -> str:
    """A portable file name: letters, digits and a few signs, not hidden, without folders."""
    kept = "".join(letter if letter.isalnum() or letter in PERMITTED else "_" for letter in name)
    kept = kept.encode()[:MAX_NAME].decode(errors="ignore").strip(". ") or "height"
    return f"_{kept}" if kept.partition(".")[0].lower() in DEVICE_NAMES or kept.startswith("-") else kept


def _writers(surface: SourceSurface, forms: Sequence[SurfaceFormat], choices: ExportChoices) -> dict[str, Writer]:
    """Suffix and writer of each file, once options and sizes are checked."""
    writers: dict[str, Writer] = {}
    mesh = grid_mesh(surface, choices.mesh_step) if set(forms) & set(get_args(MeshFormat)) else None
    for form in dict.fromkeys(forms):
        if form in _FIELDS:
            writers[".tif" if form == "tiff" else f".{form}"] = _bound(_FIELDS[form], surface)
        elif form == "csv":
            pixels_on_line(surface, choices.line_um)
            writers[".csv"] = _bound(write_csv_profile, surface, choices.line_um, semicolon=choices.semicolon)
        elif form == "stl" and choices.base_mm is not None:
            solid(cast(Mesh, mesh), choices.base_mm)  # refused before anything is written
            writers[".stl"] = _bound(write_stl, cast(Mesh, mesh), surface.name, choices.base_mm)
        else:
            writers[f".{form}"] = _bound(_MESHES[form], cast(Mesh, mesh), surface.name)
        if choices.sigma and form in ONE_LAYER:
            writers[f".sigma.{form}"] = _bound(_FIELDS[form], _sigma_of(surface))
            if form in LITTLE_ROOM and surface.doubts:
                writers[doubts_path(Path(f".sigma.{form}")).name] = _bound(_write_doubts, surface)
        if form == "png":
            writers[".png.json"] = _bound(write_png_scale, surface)
        if form in LITTLE_ROOM and surface.doubts:
            writers[doubts_path(Path(f".{form}")).name] = _bound(_write_doubts, surface)
    return writers


def _sigma_of(surface: SourceSurface) -> SourceSurface:
    """The uncertainty as a surface of its own.

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


def _write_doubts(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the doubts, one a line."""
    file.write("\n".join((surface.name, *surface.doubts, "")).encode())


def _bound(write: Callable[Concatenate[BinaryIO, Rest], None], *rest: Rest.args, **named: Rest.kwargs) -> Writer:
    """The writer with all arguments but the file."""
    return lambda file: write(file, *rest, **named)
