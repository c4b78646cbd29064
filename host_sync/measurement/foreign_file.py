"""Surfaces of other instruments' files, to be measured and reported by the same engine.

GelSight's TMD is read by this program. All other formats are read by SurfaceTopography (MIT licence), which the extra
`formats` installs. Such a file holds no ± and no mask of what is extrapolated, and its heights are relative.
"""

from __future__ import annotations

import struct
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, HeightMap
from host_sync.errors import ExportError, MeasurementError
from host_sync.export.source_surface import one_line
from host_sync.export.tmd import ANY_VERSION, read_tmd
from host_sync.results.doubts import FOREIGN_METHOD
from host_sync.results.field_file import MAX_PIXELS
from host_sync.results.reader import ResultSurface
from host_sync.results.record import MAX_PITCH_UM, ResultRecord

SQUARE: Final = 1e-3
"""Relative difference of row and column pitch up to which pixels are square."""

NO_ZERO: Final = "no zero: heights are relative, as a foreign file states no untouched surface"
MIN_FOREIGN_UM: Final = 1e-5
"""Smallest pixel pitch: probe microscopes have nanometres."""

READ_ERRORS: Final = (
    OSError, EOFError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError, SyntaxError, AssertionError,
    RuntimeError, MemoryError, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What readers raise on damaged files, XML errors among them."""

UNITS_UM: Final = {"m": 1e6, "mm": 1e3, "µm": 1.0, "um": 1.0, "nm": 1e-3, "pm": 1e-6, "Å": 1e-4}


def read_foreign(path: Path) -> ResultSurface:
    """The surface in a file of another program.

    Raises
    ------
    MeasurementError
        The file is not of a known format, damaged, or holds no map of heights with a scale.
    """
    try:
        with path.open("rb") as file:
            begins = file.read(len(ANY_VERSION))
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): name a surface file") from error
    if begins == ANY_VERSION:
        try:
            found = read_tmd(path)
        except ExportError as error:
            raise MeasurementError(str(error)) from error
        return _surface(path, HeightMap(found.z_um, found.pitch_um), found.origin, found.doubts)
    height, form, notes = _by_library(path)
    return _surface(path, height, f"{form} file", notes)


def _surface(path: Path, height: HeightMap, origin: str, notes: tuple[str, ...]) -> ResultSurface:
    rows, columns = height.z_um.shape
    if not MIN_FOREIGN_UM <= height.pitch_um <= MAX_PITCH_UM or min(rows, columns) < 2 or rows * columns > MAX_PIXELS:
        raise MeasurementError(f"{path}: {columns} x {rows} pixels of {height.pitch_um:g} µm cannot be measured")
    known = np.isfinite(height.z_um)
    if not known.any():
        raise MeasurementError(f"{path}: holds no valid height: choose another file")
    record = ResultRecord(
        name=one_line(path.stem) or "surface",
        program=one_line(origin)[:200],
        method=FOREIGN_METHOD,
        rows=rows,
        columns=columns,
        pixel_pitch_um=height.pitch_um,
        height_zero="none: heights are relative",
        masked_share=float(1.0 - known.mean()),
        warnings=(NO_ZERO, *notes),
    )
    return ResultSurface(folder=path, record=record, height=height)


def _by_library(path: Path) -> tuple[HeightMap, str, tuple[str, ...]]:
    """The first height map in a file, the name of its format, and what was done to it."""
    try:
        from SurfaceTopography.Exceptions import CannotDetectFileFormat
        from SurfaceTopography.IO import open_topography
    except ImportError as error:
        raise MeasurementError(
            f"{path}: only results and GelSight's TMD are read without the extra: pip install 'retrograph[formats]'"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the reader's own dependencies
            with open_topography(str(path)) as reader:
                form = str(reader.format())
                found = reader.topography()
                heights, sizes, unit = found.heights(), found.physical_sizes, found.unit
    except CannotDetectFileFormat as error:
        raise MeasurementError(f"{path}: is of no known format: name a result's folder or a surface file") from error
    except READ_ERRORS as error:
        raise MeasurementError(f"{path}: cannot be read as a surface ({one_line(str(error))[:120]})") from error
    if found.dim != 2 or unit not in UNITS_UM or sizes is None or not all(0.0 < float(s) < np.inf for s in sizes):
        raise MeasurementError(f"{path}: holds no map of heights with a scale: export it with its size and unit")
    return _squared(_from_top(heights, UNITS_UM[unit]), [float(size) * UNITS_UM[unit] for size in sizes], form)


def _from_top(heights: Any, factor: float) -> Float32Array:
    """Heights, µm, top row first, NaN where undefined, from an array of shape (columns, rows)."""
    z_um = np.ma.filled(np.ma.asarray(heights, dtype=np.float64) * factor, np.nan)
    return np.ascontiguousarray(z_um.T, np.float32)


def _squared(z_um: Float32Array, sizes_um: list[float], form: str) -> tuple[HeightMap, str, tuple[str, ...]]:
    """The height map with square pixels."""
    across_um, down_um = sizes_um[0] / z_um.shape[1], sizes_um[1] / z_um.shape[0]
    if abs(across_um - down_um) <= SQUARE * across_um:
        return HeightMap(z_um, across_um), form, ()
    pitch_um = min(across_um, down_um)
    columns, rows = (max(2, round(size / pitch_um)) for size in sizes_um)
    if rows * columns > MAX_PIXELS:
        raise MeasurementError(f"pixels of {across_um:g} x {down_um:g} µm are too far from square to be measured")
    resampled = np.asarray(cv2.resize(z_um, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)
    words = f"pixels of {across_um:.4g} x {down_um:.4g} µm were interpolated to squares of {pitch_um:.4g} µm"
    return HeightMap(resampled, pitch_um), form, (words,)
