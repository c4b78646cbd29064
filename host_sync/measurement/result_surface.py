"""A result folder as measurement needs it: height map, draws, slope uncertainty and what the record says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import msgspec
import numpy as np
import tifffile

from device.records import explain_validation
from device.surface import Float32Array, HeightMap, MaskArray
from device.tiff_reading import TIFF_READ_ERRORS, quiet_tiff_log
from host_sync.errors import MeasurementError

SCHEMA: Final = "retrograph.result/1"
RECORD_FILE: Final = "result.json"
HEIGHT_FILE: Final = "height_um.tif"
DRAWS_FILE: Final = "height_draws_um.tif"
SLOPE_SIGMA_FILE: Final = "slope_sigma.tif"
HEIGHT_SIGMA_FILE: Final = "height_sigma_um.tif"
EXTRAPOLATED_FILE: Final = "extrapolated.png"


class HeightScale(msgspec.Struct, frozen=True):
    """What is known of the scale; None is not measured. Measured parts are in the draws of the height already."""

    pixel_pitch_share: float | None = None
    ball_radius_share: float | None = None


class ResultRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What measurement and report read of `result.json`; a result of an earlier version may lack what is None."""

    schema: str
    name: str
    rows: int
    columns: int
    pixel_pitch_um: float
    program: str = ""
    written_utc: str = ""
    method: str = ""
    calibration_id: str = ""
    calibration_bundle: str | None = None
    calibration_passed: bool | None = None
    calibration_notes: tuple[str, ...] = ()
    scan_id: str | None = None
    frame_set: str | None = None
    gel_id: str | None = None
    reference: str = ""
    masked_share: float | None = None
    clipped_share: float | None = None
    warnings: tuple[str, ...] = ()
    held_out_error_deg: float | None = None
    height_scale: HeightScale = HeightScale()


@dataclass(frozen=True, slots=True, eq=False)
class ResultSurface:
    """One reconstruction's surface and its uncertainty.

    draws_um : float32 array of shape (K, h, w), height errors that the data allow, over the field reduced; None if
        the result holds none
    slope_sigma : float32 array of shape (H, W), standard uncertainty of either slope, NaN where invalid; or None
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, µm, likewise; or None
    extrapolated : bool array of shape (H, W), True where a slope lies beyond what the calibration taught; or None
    """

    folder: Path
    record: ResultRecord
    height: HeightMap
    draws_um: Float32Array | None
    slope_sigma: Float32Array | None
    sigma_um: Float32Array | None = None
    extrapolated: MaskArray | None = None


def read_record(folder: Path) -> ResultRecord:
    """The record of a result folder.

    Raises
    ------
    MeasurementError
        It is missing, damaged, or of an unknown version.
    """
    path = folder / RECORD_FILE
    try:
        record = msgspec.json.decode(path.read_bytes(), type=ResultRecord)
    except OSError as error:
        raise MeasurementError(
            f"{folder}: holds no {RECORD_FILE} ({error.strerror}): name a folder that retrosync reconstruct wrote"
        ) from error
    except msgspec.ValidationError as error:
        raise MeasurementError(f"{path}: {explain_validation(error)}: reconstruct the scan again") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MeasurementError(f"{path}: is no JSON ({error}): reconstruct the scan again") from error
    if record.schema != SCHEMA:
        raise MeasurementError(f"{path}: schema: {record.schema!r} is not {SCHEMA!r}: use the program that wrote it")
    if not 0.0 < record.pixel_pitch_um < float("inf"):
        raise MeasurementError(f"{path}: pixel_pitch_um: {record.pixel_pitch_um} is no length: reconstruct it again")
    return record


def read_result(folder: Path) -> ResultSurface:
    """The surface in a result folder.

    Raises
    ------
    MeasurementError
        A file is missing or damaged, or does not fit the record.
    """
    record = read_record(folder)
    height = read_height(folder, record)
    draws = folder / DRAWS_FILE
    slope_sigma, sigma_um = (
        read_beside(folder / file, height.z_um.shape) for file in (SLOPE_SIGMA_FILE, HEIGHT_SIGMA_FILE)
    )
    return ResultSurface(
        folder=folder,
        record=record,
        height=height,
        draws_um=_read_field(draws, 3) if draws.is_file() else None,
        slope_sigma=slope_sigma,
        sigma_um=sigma_um,
        extrapolated=read_mask(folder / EXTRAPOLATED_FILE, height.z_um.shape),
    )


def read_height(folder: Path, record: ResultRecord) -> HeightMap:
    """The height map alone of a result folder.

    Raises
    ------
    MeasurementError
        The file is missing or damaged, or does not fit the record.
    """
    z_um = _read_field(folder / HEIGHT_FILE, 2)
    if z_um.shape != (record.rows, record.columns):
        raise MeasurementError(
            f"{folder / HEIGHT_FILE}: has {z_um.shape[1]}x{z_um.shape[0]} pixels and the record says "
            f"{record.columns}x{record.rows}: reconstruct the scan again"
        )
    return HeightMap(z_um, record.pixel_pitch_um)


def read_beside(path: Path, shape: tuple[int, ...]) -> Float32Array | None:
    """A field of the height map's size, None if the result is of a version that did not write it.

    Raises
    ------
    MeasurementError
        The file is damaged, or of another size.
    """
    if not path.is_file():
        return None
    values = _read_field(path, 2)
    if values.shape != shape:
        raise MeasurementError(f"{path}: is not as large as the height map: reconstruct the scan again")
    return values


def read_mask(path: Path, shape: tuple[int, ...]) -> MaskArray | None:
    """A mask of the height map's size, None if the result is of a version that did not write it.

    Raises
    ------
    MeasurementError
        The file is damaged, or of another size.
    """
    if not path.is_file():
        return None
    found = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if found is None or found.shape != shape:
        raise MeasurementError(f"{path}: is damaged or not as large as the height map: reconstruct the scan again")
    return np.asarray(found > 0)


def _read_field(path: Path, dimensions: int) -> Float32Array:
    try:
        with quiet_tiff_log():
            values = np.asarray(tifffile.imread(path))
    except FileNotFoundError as error:
        raise MeasurementError(f"{path}: is missing: reconstruct the scan again") from error
    except TIFF_READ_ERRORS as error:
        raise MeasurementError(f"{path}: is truncated or damaged: reconstruct the scan again") from error
    if dimensions == 3 and values.ndim == 2:
        values = values[None]
    if values.ndim != dimensions or values.dtype != np.float32 or 0 in values.shape:
        raise MeasurementError(f"{path}: is no float32 field: reconstruct the scan again")
    return values
