"""A profile as comma-separated values: the pixels nearest to a line, not interpolated."""

from __future__ import annotations

import math
from typing import BinaryIO, TypeAlias

import numpy as np

from host_sync.csv_table import table_text
from host_sync.errors import ExportError
from host_sync.export.source_surface import SourceSurface

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
