"""The surface that is exported: what a result folder holds, checked once."""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import tifffile

from device.errors import DeviceError
from device.records import explain_validation, read_small
from device.surface import Float32Array
from device.tiff_reading import TIFF_READ_ERRORS, quiet_tiff_log
from host_sync.errors import ExportError

SCHEMA: Final = "retrograph.result/1"
RECORD_FILE: Final = "result.json"
HEIGHT_FILE: Final = "height_um.tif"
SIGMA_FILE: Final = "height_sigma_um.tif"
LONGEST_PITCH_UM: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class SourceSurface:
    """A height map with its uncertainty and origin.

    z_um : float32 array of shape (H, W), µm, NaN where invalid; some pixel is valid
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, µm, NaN where invalid; or None
    written_utc : when the result was written, as 2026-11-21T14:30:00Z; empty if unknown
    origin : what is known of it, one sentence of printable characters
    """

    name: str
    z_um: Float32Array
    pitch_um: float
    sigma_um: Float32Array | None = None
    written_utc: str = ""
    origin: str = ""

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.z_um.shape[0])

    @property
    def columns(self) -> int:
        """Number of columns."""
        return int(self.z_um.shape[1])


class _Record(msgspec.Struct, frozen=True):
    """What exports take from `result.json`."""

    schema: str
    name: str
    rows: int
    columns: int
    pixel_pitch_um: float
    program: str = ""
    written_utc: str = ""
    calibration_id: str = ""
    warnings: tuple[str, ...] = ()


def read_surface(folder: Path) -> SourceSurface:
    """The surface of a result folder.

    Raises
    ------
    ExportError
        A file is missing, damaged or does not fit the record, or no height is valid.
    """
    record = _read_record(folder)
    shape = (record.rows, record.columns)
    sigma = folder / SIGMA_FILE
    parts = (record.program, f"calibration {record.calibration_id}" if record.calibration_id else "", *record.warnings)
    return checked_surface(
        SourceSurface(
            name=one_line(record.name),
            z_um=_read_field(folder / HEIGHT_FILE, shape),
            pitch_um=record.pixel_pitch_um,
            sigma_um=_read_field(sigma, shape) if sigma.exists() else None,
            written_utc=one_line(record.written_utc),
            origin=one_line("; ".join(part for part in parts if part)),
        ),
        folder,
    )


def checked_surface(surface: SourceSurface, source: Path) -> SourceSurface:
    """The same, with NaN as the one sign of what is invalid.

    Raises
    ------
    ExportError
        The pitch is no length, or no height is valid.
    """
    if not 0.0 < surface.pitch_um < LONGEST_PITCH_UM:
        raise ExportError(f"{source}: its pixel pitch of {surface.pitch_um} um is no length: reconstruct it again")
    finite = np.isfinite(surface.z_um)
    if not finite.any():
        raise ExportError(f"{source}: no height is valid, so there is nothing to export: make the scan again")
    surface.z_um[~finite] = np.nan
    if surface.sigma_um is not None:
        surface.sigma_um[~(finite & np.isfinite(surface.sigma_um))] = np.nan
    return surface


def one_line(text: str) -> str:
    """The same with everything that is not printable as a blank: what a record says ends no header line."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()


def ascii_line(text: str) -> bytes:
    """The same in ASCII, for formats that name no encoding: letters without their accents, else a question mark."""
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    return plain.encode("ascii", "replace")


def _read_record(folder: Path) -> _Record:
    path = folder / RECORD_FILE
    if not path.is_file():
        raise ExportError(f"{folder}: holds no {RECORD_FILE}: name a folder that retrosync reconstruct wrote")
    try:
        record = msgspec.json.decode(read_small(path, "reconstruct the scan again"), type=_Record)
    except DeviceError as error:
        raise ExportError(str(error)) from error
    except msgspec.ValidationError as error:
        raise ExportError(f"{path}: {explain_validation(error)}: reconstruct the scan again") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ExportError(f"{path}: is no JSON ({error}): reconstruct the scan again") from error
    if record.schema != SCHEMA:
        raise ExportError(f"{path}: schema {record.schema!r} is not {SCHEMA!r}: use the program that wrote it")
    return record


def _read_field(path: Path, shape: tuple[int, int]) -> Float32Array:
    """A float32 field, writable.

    Raises
    ------
    ExportError
        The file is missing, damaged or of another size.
    """
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            page = tiff.pages.first
            fits = page.shape == shape and page.dtype == np.float32
            values: Float32Array | None = page.asarray() if fits else None
    except FileNotFoundError as error:
        raise ExportError(f"{path}: is missing: reconstruct the scan again") from error
    except TIFF_READ_ERRORS as error:
        raise ExportError(f"{path}: is truncated or damaged: reconstruct the scan again") from error
    if values is None:
        size = f"{shape[1]}x{shape[0]}"
        raise ExportError(f"{path}: is no float32 field of {size} pixels, as its record says: reconstruct it again")
    return values
