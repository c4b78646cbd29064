"""Reads what an entry's files hold; the last few height maps stay in memory, as a page asks for one in bands."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Final

import numpy as np
import tifffile

from device.surface import Float32Array
from host_sync.errors import ViewError
from host_sync.reconstruction.height_stack import open_heights
from host_sync.viewer.entry import MOST_PIXELS, Entry

KEPT: Final = 3
SIGMA_FILE: Final = "height_sigma_um.tif"
DRAWS_FILE: Final = "height_draws_um.tif"


class Heights:
    """Height maps by entry and page, and what lies beside them; at most `KEPT` are held."""

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[str, int | str], Float32Array] = OrderedDict()
        self._lock = Lock()

    def read(self, entry: Entry, page: int = 0) -> Float32Array:
        """The height map: float32 array of shape (H, W), µm, NaN where invalid; not to be written to.

        Raises
        ------
        ViewError
            There is no such page, or the file is damaged or of another size than its record says.
        """
        if not 0 <= page < entry.pages:
            raise ViewError(f"{entry.title}: has no frame {page}: choose one from 0 to {entry.pages - 1}")
        return self._holding((entry.stamp(), page), lambda: _read(entry, page))

    def beside(self, entry: Entry, name: str, dimensions: int) -> Float32Array | None:
        """A float32 TIFF beside the heights of a result or a difference, or None when there is none.

        Raises
        ------
        ViewError
            It is damaged.
        """
        path = entry.folder / name
        if entry.kind not in {"result", "difference"} or not path.is_file():
            return None
        return self._holding((entry.stamp(), name), lambda: _tiff(path, dimensions))

    def _holding(self, key: tuple[str, int | str], read: Callable[[], Float32Array]) -> Float32Array:
        with self._lock:
            if key not in self._held:
                self._held[key] = read()
                while len(self._held) > KEPT:
                    self._held.popitem(last=False)
            self._held.move_to_end(key)
            return self._held[key]


def _read(entry: Entry, page: int) -> Float32Array:
    if entry.kind == "video":
        try:
            stack = open_heights(entry.heights)
            z_um = np.array(stack[page], np.float32)
        except (OSError, ValueError, IndexError, tifffile.TiffFileError) as error:
            raise ViewError(f"{entry.heights}: is damaged: reconstruct the video again") from error
    else:
        z_um = _tiff(entry.heights, 2)
    if z_um.shape != entry.shape:
        raise ViewError(f"{entry.heights}: is not of the size that its record says: reconstruct the scan again")
    np.copyto(z_um, np.nan, where=~np.isfinite(z_um))
    return z_um


def _tiff(path: Path, dimensions: int) -> Float32Array:
    """A TIFF's values, when its header says that they are as many as can be held."""
    try:
        with tifffile.TiffFile(path) as tiff:
            shape = tiff.series[0].shape
            if len(shape) != dimensions or int(np.prod(shape, dtype=np.int64)) > MOST_PIXELS:
                raise ViewError(f"{path}: is not what its name says: reconstruct the scan again")
            return np.asarray(tiff.asarray(), np.float32)
    except (OSError, ValueError, KeyError, IndexError, RuntimeError, tifffile.TiffFileError) as error:
        if isinstance(error, ViewError):
            raise
        raise ViewError(f"{path}: is damaged: reconstruct the scan again") from error
