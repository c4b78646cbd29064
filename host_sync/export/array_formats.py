"""Formats of a height map as an array: float TIFF, NumPy archive, 16-bit PNG, TMD; and its profile as CSV.

TIFF: page 1 the height in µm, page 2 its standard uncertainty; float32, not compressed, NaN where invalid.

NPZ: all fields, in µm, without pickled objects.

PNG, 16-bit greyscale: 0 is invalid, 1 to 65535 span the lowest to the highest valid height. The scale is stored in text
chunks (under our names and those that Gwyddion reads), in the resolution (pHYs), and in a JSON file beside the picture
for programs that drop text.

TMD, version 2, of GelSight: a magic line, a comment, sizes, lengths in mm, float32 heights in mm, top row first.
Lengths are the pitch times the number of columns or rows. The format defines no value for invalid pixels; they are NaN,
which no reader takes for a height.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeAlias

import msgspec
import numpy as np
import tifffile
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from device.io.system import explain_os_error
from host_sync.csv_table import table_text
from host_sync.errors import ExportError
from host_sync.export.source_surface import (
    ROWS,
    SourceSurface,
    ascii_line,
    checked_surface,
    doubts_path,
    one_line,
    row_blocks,
)


def write_float_tiff(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map and its uncertainty, with the pixel pitch as resolution."""
    per_cm = 1e4 / surface.pitch_um
    pages = [("height", surface.z_um)]
    if surface.sigma_um is not None:
        pages.append(("standard uncertainty of height", surface.sigma_um))
    with tifffile.TiffWriter(file, bigtiff=sum(page.nbytes for _, page in pages) > 2**32 - 2**20) as tiff:
        for title, values in pages:
            said = f"{title}, um; pixel pitch {surface.pitch_um:g} um; NaN is invalid; {surface.name}; {surface.origin}"
            tiff.write(
                values.astype(np.float32, copy=False),
                photometric="minisblack",
                rowsperstrip=64,
                resolution=(per_cm, per_cm),
                resolutionunit="CENTIMETER",
                description=ascii_line(said).decode(),
                software="retrograph",
                metadata=None,
            )


def write_npz(file: BinaryIO, surface: SourceSurface) -> None:
    """Write `z_um`, `valid`, `pixel_pitch_um`, `name`, `origin`, `written_utc` and `doubts`.

    If known, also `sigma_um` and `extrapolated`.
    """
    arrays: dict[str, Any] = {
        "z_um": surface.z_um,
        "valid": np.isfinite(surface.z_um),
        "pixel_pitch_um": np.float64(surface.pitch_um),
        "name": np.str_(surface.name),
        "origin": np.str_(surface.origin),
        "written_utc": np.str_(surface.written_utc),
        "doubts": np.array(surface.doubts, np.str_),
    }
    if surface.sigma_um is not None:
        arrays["sigma_um"] = surface.sigma_um
    if surface.extrapolated is not None:
        arrays["extrapolated"] = surface.extrapolated
    np.savez(file, allow_pickle=False, **arrays)


UM: Final = 1e-6
TOP: Final = 65535


def write_png16(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map, quantised to 65,534 steps; the uncertainty is not written."""
    scale = png_scale(surface)
    zero_um, step_um = scale["height_at_0_um"], scale["height_step_um"]
    grey = np.empty(surface.z_um.shape, np.uint16)
    for first in range(0, surface.rows, ROWS):
        counts = np.rint((surface.z_um[first : first + ROWS] - np.float64(zero_um)) / step_um)
        grey[first : first + ROWS] = np.nan_to_num(counts, nan=0.0)
    chunks = PngInfo()
    texts = {
        "Title": surface.name,
        "Description": "height map: height_um = height_at_0_um + grey * height_step_um; grey 0 is invalid",
        **{key: repr(value) for key, value in scale.items() if isinstance(value, float)},
        "Doubts": "; ".join(surface.doubts) or "none",
        "Gwy::Title": surface.name,
        "Gwy::XReal": repr(surface.columns * surface.pitch_um * UM),
        "Gwy::YReal": repr(surface.rows * surface.pitch_um * UM),
        "Gwy::XYUnit": "m",
        "Gwy::ZUnit": "m",
        "Gwy::ZMin": repr(zero_um * UM),
        "Gwy::ZMax": repr((zero_um + TOP * step_um) * UM),
    }
    for key, value in texts.items():
        chunks.add_itxt(key, value) if not value.isascii() else chunks.add_text(key, value)
    picture = Image.fromarray(grey)
    picture.save(file, "png", pnginfo=chunks, dpi=(25400.0 / surface.pitch_um,) * 2, compress_level=3)


def write_png_scale(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the scale of the picture as JSON."""
    file.write(msgspec.json.format(msgspec.json.encode(png_scale(surface)), indent=2) + b"\n")


def png_scale(surface: SourceSurface) -> dict[str, Any]:
    """Return the scale of the picture: `height_um = height_at_0_um + grey * height_step_um`, grey 0 is invalid."""
    lowest, highest = float(np.nanmin(surface.z_um)), float(np.nanmax(surface.z_um))
    step_um = (highest - lowest) / (TOP - 1) or 1e-6
    return {
        "name": surface.name,
        "origin": surface.origin,
        "pixel_pitch_um": surface.pitch_um,
        "height_at_0_um": lowest - step_um,
        "height_step_um": step_um,
        "grey_of_invalid": 0,
        "doubts": list(surface.doubts),
    }


# A profile as comma-separated values: the pixels nearest to a line, not interpolated.

LineUm: TypeAlias = tuple[float, float, float, float]
"""Start column, start row, end column, end row, µm from the centre of the first pixel."""


def write_csv_profile(file: BinaryIO, surface: SourceSurface, line_um: LineUm | None, semicolon: bool = False) -> None:
    """Write distance along the line, column, row, height, standard uncertainty and doubts; invalid values are empty.

    line_um : None takes the middle row
    semicolon : as for `table_text`

    Raises
    ------
    ExportError
        The line leaves the field, or has no length.
    """
    distance_um, rows, columns = pixels_on_line(surface, line_um)
    z_um = surface.z_um[rows, columns]
    sigma_um = np.full_like(z_um, np.nan) if surface.sigma_um is None else surface.sigma_um[rows, columns]
    doubts = "; ".join(surface.doubts)
    rows_of_numbers = zip(distance_um, columns, rows, z_um, sigma_um, strict=True)
    table = [(_nine(along), int(column), int(row), _nine(z), _nine(sigma), doubts)
             for along, column, row, z, sigma in rows_of_numbers]  # fmt: skip
    names = ("distance_um", "column", "row", "height_um", "height_sigma_um", "doubts")
    file.write(table_text([names, *table], semicolon=semicolon).encode())


def pixels_on_line(surface: SourceSurface, line_um: LineUm | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the distance (µm), row and column of the pixels nearest to a line, one per step of its longer direction.

    Raises
    ------
    ExportError
        The line leaves the field, or has no length.
    """
    last = (surface.columns - 1, surface.rows - 1)
    if line_um is None:
        middle = float(surface.rows // 2)
        ends = (0.0, middle, float(last[0]), middle)
    else:
        x0, y0, x1, y1 = (place / surface.pitch_um for place in line_um)
        ends = (x0, y0, x1, y1)
    for place, limit in zip(ends, last * 2, strict=True):
        if not -0.5 <= place <= limit + 0.5:
            raise ExportError(
                f"the line leaves the field, which ends at {last[0] * surface.pitch_um:g}, "
                f"{last[1] * surface.pitch_um:g} um: move it inside"
            )
    steps = round(max(abs(ends[2] - ends[0]), abs(ends[3] - ends[1])))
    if line_um is not None and steps == 0:
        raise ExportError("the line is shorter than a pixel: move its ends apart")
    share = np.linspace(0.0, 1.0, steps + 1)
    columns, rows = (
        np.clip(np.rint(ends[axis] + share * (ends[axis + 2] - ends[axis])).astype(np.intp), 0, last[axis])
        for axis in (0, 1)
    )
    return share * math.dist(ends[:2], ends[2:]) * surface.pitch_um, rows, columns


def _nine(value: float) -> float:
    """Return the number to nine digits."""
    return float(f"{value:.9g}")


TMD_MAGIC: Final = b"Binary TrueMap Data File v2.0\r\n\0"
TMD_ANY_VERSION: Final = b"Binary TrueMap Data File"
UM_TO_MM: Final = 1e-3
TMD_SIZES: Final = "<IIffff"
TMD_MARKED: Final = "Retrograph, DOUBTFUL"
"""Comment of a surface that has doubts; their reasons lie in a text file beside it."""

TMD_COMMENT_BYTES: Final = 21
"""Of the comment that GelSight's own program writes; surfalize reads files with this length only."""

TMD_UNNAMED: Final = "doubtful"
TMD_MAX_DOUBTS_BYTES: Final = 65_536
TMD_MAX_COMMENT_BYTES: Final = 4096
TMD_MAX_PIXELS: Final = 2**31
TMD_SQUARE: Final = 1e-3
"""Relative tolerance between column and row pitch: lengths are float32."""


def write_tmd(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map; neither uncertainty nor name nor the doubts' reasons are written."""
    comment = ascii_line(TMD_MARKED if surface.doubts else "Retrograph")
    file.write(TMD_MAGIC + comment.ljust(TMD_COMMENT_BYTES) + b"\r\n\0")
    lengths_mm = (surface.columns * surface.pitch_um * UM_TO_MM, surface.rows * surface.pitch_um * UM_TO_MM)
    file.write(struct.pack(TMD_SIZES, surface.columns, surface.rows, *lengths_mm, 0.0, 0.0))
    file.writelines(row_blocks(surface.z_um, UM_TO_MM, "<f4"))


def read_tmd(path: Path) -> SourceSurface:
    """Return the surface in a TMD file of version 2, with the doubts that it was written with.

    The name of the surface is that of the file.

    Raises
    ------
    ExportError
        It is not a TMD file, is damaged, or its pixels are not square.
    """
    try:
        with path.open("rb") as file:
            head = file.read(len(TMD_MAGIC) + TMD_MAX_COMMENT_BYTES + struct.calcsize(TMD_SIZES))
        size = path.stat().st_size
    except OSError as error:
        raise ExportError(f"{path}: cannot be read {explain_os_error(error)}") from error
    if not head.startswith(TMD_MAGIC):
        what = "is a TMD file of another version" if head.startswith(TMD_ANY_VERSION) else "is no TMD file"
        raise ExportError(f"{path}: {what}: name one of version 2.0")
    end = head.find(b"\0", len(TMD_MAGIC), len(TMD_MAGIC) + TMD_MAX_COMMENT_BYTES)
    start = end + 1 + struct.calcsize(TMD_SIZES)
    if end < 0 or len(head) < start:
        raise ExportError(f"{path}: ends before its sizes do: copy it again")
    columns, rows, across_mm, down_mm, _, _ = struct.unpack_from(TMD_SIZES, head, end + 1)
    if not 0 < columns * rows <= TMD_MAX_PIXELS or size < start + 4 * columns * rows:
        raise ExportError(f"{path}: is too short for the {columns}x{rows} pixels that it declares: copy it again")
    pitch_um, down_um = across_mm / columns / UM_TO_MM, down_mm / rows / UM_TO_MM
    if not abs(pitch_um - down_um) <= TMD_SQUARE * abs(pitch_um):
        raise ExportError(f"{path}: its pixels are {pitch_um:g} x {down_um:g} um: export one with square pixels")
    z_um = np.fromfile(path, "<f4", columns * rows, offset=start).reshape(rows, columns)
    z_um /= np.float32(UM_TO_MM)
    comment = head[len(TMD_MAGIC) : end].decode("ascii", "replace").strip()
    doubts = _doubts_beside(path) if comment == TMD_MARKED else ()
    surface = SourceSurface(
        name=path.stem,
        z_um=z_um.astype(np.float32, copy=False),
        pitch_um=pitch_um,
        origin=one_line("; ".join(("TMD file", comment, *doubts))),
        doubts=doubts,
        short_doubts=tuple(dict.fromkeys(doubt.partition(":")[0] for doubt in doubts)),
    )
    return checked_surface(surface, path)


def _doubts_beside(path: Path) -> tuple[str, ...]:
    """Return the doubts in the text file beside a marked file; one that names the mark where there is none."""
    try:
        text = doubts_path(path).read_bytes()[:TMD_MAX_DOUBTS_BYTES].decode(errors="replace")
    except OSError:
        text = ""
    found = tuple(one_line(line) for line in text.splitlines()[1:] if line.strip())
    return found or (
        f"{TMD_UNNAMED}: the file is marked, and {doubts_path(path).name} with the reasons is not next to it",
    )
