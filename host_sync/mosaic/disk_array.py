"""Arrays in files, whose room is taken from the disk before anything is written to them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

CHUNK: Final = 1 << 20

Scalar = TypeVar("Scalar", bound=np.generic)


def disk_array(path: Path, dtype: type[Scalar], shape: tuple[int, int]) -> NDArray[Scalar]:
    """Zeros in a new file, as a memory map of shape (H, W).

    A memory map of a file with holes ends the program without a word (SIGBUS) where the disk fills up.

    Raises
    ------
    OSError
        The disk has no room for it.
    """
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    with path.open("wb") as stream:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(stream.fileno(), 0, size)
        else:
            for start in range(0, size, CHUNK):
                stream.write(bytes(min(CHUNK, size - start)))
    return np.memmap(path, dtype, "r+", shape=shape)
