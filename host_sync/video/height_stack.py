"""Height maps of a sequence in one file.

The file is a multi-page TIFF in strips, not compressed. ImageJ opens it as a time series with pitch and frame interval,
`tifffile.imread` returns an array of shape (T, H, W), and `tifffile.memmap` reads single pages. ImageJ reads neither
tiles nor BigTIFF, hence strips; only a stack larger than the 4 GB of a classic TIFF is written as BigTIFF, which
tifffile and ImageJ's Bio-Formats plug-in read.
"""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np
import tifffile

from device.surface.fields import Float32Array

CLASSIC_BYTES: Final = 4 * 10**9


class HeightStack:
    """Writes height maps of one size; a context manager.

    Parameters
    ----------
    path : the file to write
    shape : (H, W)
    max_pages : maximum number of pages
    pitch_um : pixel pitch, µm
    rate_hz : frames per second
    """

    def __init__(self, path: Path, shape: tuple[int, int], max_pages: int, pitch_um: float, rate_hz: float) -> None:
        self._path = path
        self._shape = shape
        self._max_pages = max_pages
        self._per_um = 1.0 / pitch_um
        self._interval_s = 1.0 / rate_hz
        self._pages = 0
        self._writer = tifffile.TiffWriter(path, bigtiff=max_pages * shape[0] * shape[1] * 4 > CLASSIC_BYTES)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.close()
        if self._pages not in (0, self._max_pages):
            with tifffile.TiffFile(self._path, mode="r+") as tiff:
                tiff.pages.first.tags["ImageDescription"].overwrite(self._description(self._pages))

    def append(self, z_um: Float32Array) -> None:
        """Write the next page: float32 array of shape (H, W), µm, NaN where invalid.

        Raises
        ------
        OSError
            The disk refused the write.
        """
        self._writer.write(
            np.ascontiguousarray(z_um, np.float32),
            contiguous=True,
            photometric="minisblack",
            rowsperstrip=self._shape[0],
            resolution=(self._per_um, self._per_um),
            resolutionunit="NONE",
            description=self._description(self._max_pages) if self._pages == 0 else None,
            metadata=None,
        )
        self._pages += 1

    def _description(self, pages: int) -> str:
        """Return metadata for ImageJ: pages are frames, pixels are µm."""
        return (
            f"ImageJ=1.53t\nimages={pages}\nframes={pages}\nunit=um\nfinterval={self._interval_s:.9g}\n"
            f"fps={1.0 / self._interval_s:.9g}\nloop=false\n"
        )


def open_heights(path: Path) -> Float32Array:
    """Return the stack as a read-only array of shape (T, H, W), mapped from disk."""
    with tifffile.TiffFile(path) as tiff:
        first, count = tiff.pages.first, len(tiff.pages)
        rows, columns = first.shape
        offset = first.dataoffsets[0]
        order = tiff.byteorder
    return np.memmap(path, np.dtype(np.float32).newbyteorder(order), "r", offset, (count, rows, columns))
