"""Stated places of presses: a CSV file with the columns scan, right_mm, down_mm."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Final

import numpy as np

from host_sync.errors import MosaicError
from host_sync.mosaic.overlaps import Layout
from host_sync.mosaic.presses import Press

COLUMNS: Final = ("scan", "right_mm", "down_mm")
MAX_BYTES: Final = 10_000_000


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
    try:
        if path.stat().st_size > MAX_BYTES:
            raise MosaicError(f"{path}: is too large for a layout: name another file")
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise MosaicError(f"{path}: cannot be read ({error.strerror}): name the layout's CSV file") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise MosaicError(f"{path}: is no CSV text: name the layout's CSV file") from error
    places = {}
    for number, row in enumerate(rows):
        try:
            name, right_mm, down_mm = row["scan"], float(row["right_mm"]), float(row["down_mm"])
        except (KeyError, TypeError, ValueError) as error:
            raise MosaicError(f"{path}: line {number + 2}: needs {', '.join(COLUMNS)}, the last two numbers") from error
        if not np.isfinite([right_mm, down_mm]).all():
            raise MosaicError(f"{path}: line {number + 2}: is no place: give finite numbers")
        places[name] = (down_mm, right_mm)
    missing = [press.name for press in presses if press.name not in places]
    if missing:
        raise MosaicError(f"{path}: holds no line for {missing[0]}: add one for each scan")
    per_mm = 1e3 / presses[0].record.pixel_pitch_um
    return Layout(np.array([places[press.name] for press in presses], np.float64) * per_mm, within_mm * per_mm)
