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
