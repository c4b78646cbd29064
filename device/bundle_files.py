"""The files of a published bundle: only those that its manifest lists, and raw frames of the size that it states."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from device.errors import RecordError
from device.raw_file import read_raw
from device.records import FileEntry
from hal.frame import RawFrame


def listed_file(directory: Path, files: Mapping[str, FileEntry], name: str) -> Path:
    """Path of a file of the bundle in `directory`.

    Raises
    ------
    RecordError
        The manifest lists no such file.
    """
    if name not in files:
        raise RecordError(f"{directory}: holds no file {name!r}: its files are {', '.join(files)}")
    return directory / name


def recorded_frame(path: Path, shape: tuple[int, int]) -> RawFrame:
    """The raw frame in a file, of `shape` (H, W) as its record states.

    Raises
    ------
    RecordError
        The file is missing or damaged, or of another size.
    """
    return read_raw(path, shape)
