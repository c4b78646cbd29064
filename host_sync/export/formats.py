"""Formats and options of an export; a format is one declaration, and its writer is loaded when it writes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Final

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
    "tmd": Format("tmd:write_tmd", one_layer=True, little_room=True),
    "tiff": Format("array_formats:write_float_tiff", suffix="tif"),
    "png": Format("array_formats:write_png16", side_writer="array_formats:write_png_scale", side_suffix="png.json"),
    "npz": Format("array_formats:write_npz"),
    "csv": Format("csv_profile:write_csv_profile"),
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
