"""Options of an export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from host_sync.export.csv_profile import LineUm


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
