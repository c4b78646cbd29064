"""The fitted inverse map as a file of a calibration bundle."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path
from typing import Final

import numpy as np

from device.errors import RecordError
from device.inverse_map.model import InverseMap

MODEL_FILE: Final = "inverse-map.npz"
MAX_MODEL_BYTES: Final = 64 << 20
"""A map takes a few megabytes; a file that unpacks to more than this is not unpacked."""

_READ_ERRORS: Final = (
    OSError,
    ValueError,
    TypeError,
    EOFError,
    LookupError,
    ArithmeticError,
    MemoryError,
    RuntimeError,
    SyntaxError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)
"""What zipfile and numpy raise for bytes that are no model, or no longer."""


def write_model(path: Path, inverse_map: InverseMap) -> None:
    """Write the map so that `read_model` returns it bit for bit."""
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **inverse_map.arrays())


def read_model(path: Path) -> InverseMap:
    """Return the inverse map in a file.

    Raises
    ------
    RecordError
        The file is missing, damaged or holds something else.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked_bytes = sum(member.file_size for member in archive.infolist())
        if unpacked_bytes > MAX_MODEL_BYTES:
            raise RecordError(f"{path}: unpacks to {unpacked_bytes / 1e6:.0f} MB, more than any model: calibrate again")
        with np.load(path, allow_pickle=False) as arrays:
            return InverseMap.from_arrays(dict(arrays), str(path))
    except _READ_ERRORS as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(f"{path}: holds no readable model ({error}): calibrate again") from error
