"""The surface to export, from a result folder, checked once, and its fields as bytes."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import DTypeLike

from device.surface import Float32Array, MaskArray
from host_sync.errors import ExportError
from host_sync.results.reader import read_result
from host_sync.results.record import doubtful

MAX_PITCH_UM: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class SourceSurface:
    """A height map with its uncertainty and origin.

    z_um : float32 array of shape (H, W), µm, NaN where invalid; some pixel is valid
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, µm, NaN where invalid; or None
    written_utc : when the result was written, as 2026-11-21T14:30:00Z; empty if unknown
    origin : program, calibration and doubts in one line of printable characters
    doubts : reasons to distrust the heights, one printable line each
    short_doubts : the same in a few words, for formats with little room
    extrapolated : bool array of shape (H, W), True where a slope lies beyond the training samples and
        the skin is not known to be untouched; or None
    """

    name: str
    z_um: Float32Array
    pitch_um: float
    sigma_um: Float32Array | None = None
    written_utc: str = ""
    origin: str = ""
    extrapolated: MaskArray | None = None
    doubts: tuple[str, ...] = ()
    short_doubts: tuple[str, ...] = ()

    @property
    def doubtful(self) -> str:
        """The doubts in a few words, for a line that has little room; empty without doubts."""
        return doubtful(self.short_doubts)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.z_um.shape[0])

    @property
    def columns(self) -> int:
        """Number of columns."""
        return int(self.z_um.shape[1])


def read_surface(folder: Path) -> SourceSurface:
    """Return the surface of a result folder.

    Raises
    ------
    UnreadableResult
        A file is missing or damaged, or does not fit the record.
    ExportError
        No height is valid.
    """
    result = read_result(folder, samples=False)
    record = result.record
    doubts = tuple(one_line(doubt.sentence) for doubt in result.doubts)
    parts = (record.program, f"calibration {record.calibration_id}" if record.calibration_id else "", *doubts)
    return checked_surface(
        SourceSurface(
            name=one_line(record.name),
            z_um=result.height.z_um,
            pitch_um=result.height.pitch_um,
            sigma_um=result.sigma_um,
            written_utc=one_line(record.written_utc),
            origin=one_line("; ".join(part for part in parts if part)),
            extrapolated=result.extrapolated,
            doubts=doubts,
            short_doubts=tuple(dict.fromkeys(doubt.kind for doubt in result.doubts)),
        ),
        folder,
    )


def checked_surface(surface: SourceSurface, source: Path) -> SourceSurface:
    """Return the surface with NaN as the only marker of invalid pixels.

    Raises
    ------
    ExportError
        The pitch is not positive, or no height is valid.
    """
    if not 0.0 < surface.pitch_um < MAX_PITCH_UM:
        raise ExportError(f"{source}: pixel pitch must be positive, got {surface.pitch_um} um: reconstruct it again")
    finite = np.isfinite(surface.z_um)
    if not finite.any():
        raise ExportError(f"{source}: no height is valid, so there is nothing to export: make the scan again")
    surface.z_um[~finite] = np.nan
    if surface.sigma_um is not None:
        surface.sigma_um[~(finite & np.isfinite(surface.sigma_um))] = np.nan
    return surface


def doubts_path(path: Path) -> Path:
    """Return the text file beside a surface's file whose format has no room for the doubts."""
    return path.with_name(f"{path.name}.doubts.txt")


def one_line(text: str) -> str:
    """Return the text with blanks for unprintable characters, so that it stays on one header line."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()


def ascii_line(text: str) -> bytes:
    """Return the text in ASCII, for formats without an encoding: accents are removed, other characters become `?`."""
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    return plain.encode("ascii", "replace")


ROWS: Final = 64


def row_blocks(
    field_um: Float32Array, factor: float, kind: DTypeLike, invalid: float = np.nan, padding: int = 0
) -> Iterator[bytes]:
    """Yield the bytes of `field_um` times `factor`, row by row from the top.

    field_um : float32 array of shape (H, W), NaN where invalid
    kind : number format of the file; integers are rounded
    invalid : value of invalid pixels
    padding : zero bytes after each row
    """
    kind = np.dtype(kind)
    for first in range(0, field_um.shape[0], ROWS):
        values = field_um[first : first + ROWS] * np.float64(factor)
        if kind.kind in "iu":
            np.rint(values, out=values)
        np.nan_to_num(values, copy=False, nan=invalid)
        block = values.astype(kind)
        if padding:
            wide = np.zeros((block.shape[0], block.shape[1] * kind.itemsize + padding), np.uint8)
            wide[:, : wide.shape[1] - padding] = block.view(np.uint8)
            yield wide.tobytes()
        else:
            yield block.tobytes()


def integer_quantum(field_um: Float32Array) -> float:
    """Return the step (µm, exact in float32) at which the highest valid value has about 2³⁰ steps."""
    highest = max(float(np.nanmax(field_um)), -float(np.nanmin(field_um)))
    return float(np.float32(highest / 2**30)) if highest > 1e-20 else 1e-9
