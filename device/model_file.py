"""The fitted inverse map as a file of a calibration bundle."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Final

import numpy as np

from device.errors import RecordError
from device.inverse_map import InverseMap

MODEL_FILE: Final = "inverse-map.npz"


def write_model(path: Path, inverse_map: InverseMap) -> None:
    """Write the map so that `read_model` returns it bit for bit."""
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **inverse_map.arrays())


def read_model(path: Path) -> InverseMap:
    """The inverse map in a file.

    Raises
    ------
    RecordError
        The file is missing, damaged or holds something else.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return InverseMap.from_arrays(dict(arrays), str(path))
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(f"{path}: holds no readable model ({error}): calibrate again") from error
