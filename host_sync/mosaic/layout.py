"""Stated places of presses: a CSV file with the columns scan, right_mm, down_mm."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from host_sync.csv_table import number_in, read_table
from host_sync.errors import MosaicError
from host_sync.mosaic.overlaps import Layout
from host_sync.mosaic.presses import Press

COLUMNS: Final = ("scan", "right_mm", "down_mm")


def read_layout(path: Path, presses: list[Press], within_mm: float) -> Layout:
    """The layout of the presses.

    within_mm : how far off it may be

    Raises
    ------
    MosaicError
        The file cannot be read, or does not hold every press.
    """
    if not within_mm > 0.0:
        raise MosaicError(f"--within-mm {within_mm:g}: is no length: give a positive number")
    places = {}
    for number, row in enumerate(read_table(path, MosaicError), start=2):
        place = [number_in(row.get(name, "")) for name in COLUMNS[1:]]
        if "scan" not in row or not np.isfinite(place).all():
            raise MosaicError(f"{path}: line {number}: needs {', '.join(COLUMNS)}, the last two finite numbers")
        places[row["scan"]] = place[::-1]
    missing = [press.name for press in presses if press.name not in places]
    if missing:
        raise MosaicError(f"{path}: holds no line for {missing[0]}: add one for each scan")
    per_mm = 1e3 / presses[0].record.pixel_pitch_um
    return Layout(np.array([places[press.name] for press in presses], np.float64) * per_mm, within_mm * per_mm)
