"""Exports a surface to files for other programs, each written atomically."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from host_sync.errors import ExportError
from host_sync.export.csv_profile import pixels_on_line
from host_sync.export.formats import FORMATS, ExportChoices, load
from host_sync.export.mesh import grid_mesh, solid
from host_sync.export.publishing import Writer, check_free, check_own, publish, withdraw
from host_sync.export.source_surface import SourceSurface, doubts_path

MAX_NAME: Final = 120
"""Longest file name without suffix, bytes."""
PERMITTED: Final = "-_.+ "
DEVICE_NAMES: Final = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}


def export_surface(
    surface: SourceSurface, forms: Sequence[str], folder: Path, choices: ExportChoices
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
    surface: SourceSurface, forms: Sequence[str], choices: ExportChoices
) -> tuple[tuple[str, ...], list[str]]:
    """The formats that can hold the surface, and a sentence for each other reason to refuse one.

    Raises
    ------
    ExportError
        The line of the profile is not on the surface: that is for the user to correct.
    """
    possible: list[str] = []
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


def _writers(surface: SourceSurface, forms: Sequence[str], choices: ExportChoices) -> dict[str, Writer]:
    """Suffix and writer of each file, once options and sizes are checked."""
    writers: dict[str, Writer] = {}
    mesh = grid_mesh(surface, choices.mesh_step) if any(FORMATS[form].is_mesh for form in forms) else None
    if mesh and "stl" in forms and choices.base_mm is not None:
        solid(mesh, choices.base_mm)  # refused before anything is written
    for name in dict.fromkeys(forms):
        form = FORMATS[name]
        suffix = f".{form.suffix or name}"
        options: tuple[Any, ...] = ()
        if name == "csv":
            pixels_on_line(surface, choices.line_um)
            options = (choices.line_um, choices.semicolon)
        elif mesh and form.is_mesh:
            options = (surface.name, choices.base_mm) if name == "stl" else (surface.name,)
        written = {suffix: (form.writer, mesh if form.is_mesh else surface, options)}
        if choices.sigma and form.one_layer:
            written[f".sigma{suffix}"] = (form.writer, _sigma_of(surface), ())
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


def _write_doubts(surface: SourceSurface, file: BinaryIO) -> None:
    """Write the doubts, one a line."""
    file.write("\n".join((surface.name, *surface.doubts, "")).encode())
