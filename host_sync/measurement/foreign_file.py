"""Surfaces of other instruments' files, to be measured and reported by the same engine.

GelSight's TMD is read by this program. All other formats are read by SurfaceTopography (MIT licence), which the extra
`formats` installs. Such a file holds no ± and no mask of what is extrapolated, and its heights are relative.
"""

from __future__ import annotations

import struct
import warnings
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.errors import ExportError, MeasurementError
from host_sync.export.array_formats import TMD_ANY_VERSION, read_tmd
from host_sync.export.source_surface import one_line
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
    """Return the surface in a file of another program.

    Raises
    ------
    MeasurementError
        The file is not of a known format, damaged, or holds no map of heights with a scale.
    """
    try:
        with path.open("rb") as file:
            begins = file.read(len(TMD_ANY_VERSION))
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): name a surface file") from error
    if begins == TMD_ANY_VERSION:
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
    """Return the first height map in a file, the name of its format, and what was done to it."""
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
    """Return heights, µm, top row first, NaN where undefined, from an array of shape (columns, rows)."""
    z_um = np.ma.filled(np.ma.asarray(heights, dtype=np.float64) * factor, np.nan)
    return np.ascontiguousarray(z_um.T, np.float32)


def _squared(z_um: Float32Array, sizes_um: list[float], form: str) -> tuple[HeightMap, str, tuple[str, ...]]:
    """Return the height map with square pixels."""
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


# The difference of two height maps of the same pixels, such as a result and the maker's own map of the same scan.

SAME_PITCH: Final = 0.01
MIN_COMMON_FRACTION: Final = 0.01
DEPTH_PERCENTILES: Final = (0.5, 99.5)
"""Depth is from one to the other: single pixels do not count."""


@dataclass(frozen=True, slots=True)
class MapDifference:
    """Rms and mean of the absolute difference about its mean plane, depth of the other map (µm), share compared."""

    rms_um: float
    mean_um: float
    depth_um: float
    compared: float

    @property
    def percent_of_depth(self) -> float | None:
        """The rms in percent of the depth; None of a flat map."""
        return 100.0 * self.rms_um / self.depth_um if self.depth_um > 0.0 else None


def map_difference(height: HeightMap, other: HeightMap) -> MapDifference:
    """Return the difference of `height` to `other`, pixel by pixel; a plane is taken off, as two datums differ by one.

    Raises
    ------
    MeasurementError
        The maps have other sizes or pitches, or hardly a pixel in common.
    """
    if height.z_um.shape != other.z_um.shape:
        (rows, columns), (other_rows, other_columns) = height.z_um.shape, other.z_um.shape
        raise MeasurementError(
            f"the maps have {columns}x{rows} and {other_columns}x{other_rows} pixels: compare maps of the same scan"
        )
    if abs(height.pitch_um - other.pitch_um) > SAME_PITCH * other.pitch_um:
        raise MeasurementError(
            f"the maps have pixels of {height.pitch_um:g} and {other.pitch_um:g} µm: compare maps of the same scan"
        )
    both = np.asarray(np.isfinite(height.z_um) & np.isfinite(other.z_um))
    if both.mean() < MIN_COMMON_FRACTION:
        raise MeasurementError("the maps have hardly a valid pixel in common: compare maps of the same scan")
    off = _without_plane(height.z_um.astype(np.float64) - other.z_um, both)
    low, high = np.percentile(_without_plane(other.z_um.astype(np.float64), both), DEPTH_PERCENTILES)
    rms, mean = float(np.sqrt(np.mean(off**2))), float(np.mean(np.abs(off)))
    return MapDifference(rms, mean, float(high - low), float(both.mean()))


def _without_plane(values: Float64Array, where: MaskArray) -> Float64Array:
    """Return the values there less the plane that fits them, float64 array of shape (N,)."""
    row, column = np.nonzero(where)
    scale = float(max(values.shape))
    design = np.stack([column / scale, row / scale, np.ones(len(row))], axis=-1)
    taken = values[where]
    normal = design.T @ design
    return np.asarray(taken - design @ np.linalg.lstsq(normal, design.T @ taken, rcond=None)[0])
