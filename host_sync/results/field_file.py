"""Fields and masks on disk: float32 TIFF and PNG, written plainly and read with every declared size checked first.

A TIFF of a few kilobytes can declare gigabytes. Before anything is decoded, the declared size is compared with the
pixel budget and with what the file holds: fields are not compressed, and the segments of samples are inflated to count.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from device.io.tiff import TIFF_READ_ERRORS, quiet_tiff_log
from device.surface import Float32Array, MaskArray
from host_sync.errors import UnreadableResult

MAX_PIXELS: Final = 1 << 26
"""Five times the pixels of a 12-megapixel sensor."""

MAX_TILE_VALUES: Final = 1 << 20
"""Values in a tile or strip of a smaller field, which may be padded."""

BLOCK_BYTES: Final = 1 << 16
_NOT_COMPRESSED: Final = 1
_ZLIB: Final = frozenset({8, 32946})
_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_AGAIN: Final = "reconstruct the scan again"


def write_field(path: Path, values: Float32Array, pitch_um: float, description: str) -> None:
    """Write a float32 TIFF, tiled, not compressed (every reader opens it), NaN where invalid, with its resolution."""
    per_cm = 1e4 / pitch_um
    tifffile.imwrite(
        path,
        np.ascontiguousarray(values, np.float32),
        tile=(256, 256),
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
        description=f"{description}; pixel pitch {pitch_um:g} um; NaN is invalid",
        metadata=None,
    )


def read_field(path: Path, shape: tuple[int, int] | None = None) -> Float32Array:
    """Return the values of a float32 TIFF: array of shape (H, W).

    shape : the shape that the field must have, if known

    Raises
    ------
    UnreadableResult
        The file is missing, damaged, of another shape, or declares more than it holds.
    """
    with _opened(path) as tiff:
        _check_field(path, tiff, shape)
        return np.asarray(tiff.asarray(), np.float32)


def read_samples(path: Path, max_values: int = MAX_PIXELS) -> Float32Array:
    """Monte Carlo samples of the height error: float32 array of shape (K, h, w).

    Raises
    ------
    UnreadableResult
        The file is missing or damaged, holds more than `max_values`, or declares more than it holds.
    """
    with _opened(path) as tiff:
        found = _declared_shape(path, tiff)
        found = (1, *found) if len(found) == 2 else found
        if len(found) != 3 or math.prod(found) > max_values:
            raise UnreadableResult(f"{path}: declares {math.prod(found)} values, more than its result has: {_AGAIN}")
        for number in range(len(tiff.pages)):
            _check_segments(path, tiff, tiff.pages.get(number).aspage())
        return np.asarray(tiff.asarray(), np.float32).reshape(found)


def read_shape(path: Path) -> tuple[int, int]:
    """Return the shape (H, W) that a field's header declares, with the checks of `read_field`.

    Raises
    ------
    UnreadableResult
        As for `read_field`.
    """
    with _opened(path) as tiff:
        return _check_field(path, tiff, None)


def read_stack_page(path: Path, page: int, shape: tuple[int, int]) -> Float32Array:
    """Return one page of a video's height maps: float32 array of shape (H, W), read without the other pages.

    Raises
    ------
    UnreadableResult
        The file is missing or damaged, or holds no such page of that shape.
    """
    with _opened(path) as tiff:
        first = tiff.pages.first
        if (first.shape, first.dtype, first.compression) != (shape, np.dtype(np.float32), _NOT_COMPRESSED):
            raise UnreadableResult(f"{path}: does not hold the pages that its record states: {_AGAIN}")
        order = np.dtype(np.float32).newbyteorder(tiff.byteorder)
        place = first.dataoffsets[0] + page * 4 * math.prod(shape)
        return np.array(np.memmap(path, order, "r", place, shape), np.float32)


def read_mask(path: Path, shape: tuple[int, ...]) -> MaskArray:
    """Return the mask in a PNG of a known shape (H, W).

    Raises
    ------
    UnreadableResult
        The file is damaged, or of another shape.
    """
    try:
        data = path.read_bytes() if path.is_file() and path.stat().st_size <= MAX_PIXELS else b""
    except OSError as error:
        raise UnreadableResult(f"{path}: cannot be read ({error.strerror}): {_AGAIN}") from error
    declared = (int.from_bytes(data[20:24]), int.from_bytes(data[16:20]))
    if data[:8] == _PNG_SIGNATURE and declared == shape:
        found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        if found is not None:
            return np.asarray(found > 0)
    raise UnreadableResult(f"{path}: is damaged or not as large as the height map: {_AGAIN}")


def write_mask(path: Path, mask: MaskArray) -> None:
    """Write a mask of shape (H, W) as a PNG of one bit a pixel, white where it holds."""
    values: NDArray[np.uint8] = np.asarray(mask, np.bool_).view(np.uint8) * np.uint8(255)
    done, encoded = cv2.imencode(".png", values, [cv2.IMWRITE_PNG_BILEVEL, 1, cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert done  # noqa: S101 - encoding to memory fails only without memory
    path.write_bytes(encoded.tobytes())


@contextmanager
def _opened(path: Path) -> Iterator[tifffile.TiffFile]:
    """An open TIFF; what fails while it is read becomes an UnreadableResult."""
    if not path.is_file():
        raise UnreadableResult(f"{path}: is missing: {_AGAIN}")
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            yield tiff
    except UnreadableResult:
        raise
    except (*TIFF_READ_ERRORS, zlib.error) as error:
        raise UnreadableResult(f"{path}: is truncated or damaged: {_AGAIN}") from error


def _declared_shape(path: Path, tiff: tifffile.TiffFile) -> tuple[int, ...]:
    """Return the shape of the values that reading returns."""
    series = tiff.series[0]
    if series.dtype != np.float32 or 0 in series.shape:
        raise UnreadableResult(f"{path}: is not a float32 field: {_AGAIN}")
    return tuple(series.shape)


def _check_field(path: Path, tiff: tifffile.TiffFile, shape: tuple[int, int] | None) -> tuple[int, int]:
    """Return the declared shape (H, W), once it is known that the file holds all of its values, not compressed."""
    found = _declared_shape(path, tiff)
    if len(found) != 2 or len(tiff.pages) != 1:
        raise UnreadableResult(f"{path}: is not a float32 field: {_AGAIN}")
    if shape is not None and found != shape:
        raise UnreadableResult(
            f"{path}: has {found[1]} x {found[0]} pixels, expected {shape[1]} x {shape[0]}: {_AGAIN}"
        )
    if math.prod(found) > MAX_PIXELS:
        raise UnreadableResult(f"{path}: declares more than {MAX_PIXELS} values: {_AGAIN}")
    page = tiff.pages.first
    if page.compression != _NOT_COMPRESSED or _tile_values(page) > max(math.prod(found), MAX_TILE_VALUES):
        raise UnreadableResult(f"{path}: is not stored in the format of a result: {_AGAIN}")
    if 4 * math.prod(found) > tiff.filehandle.size:
        raise UnreadableResult(f"{path}: is truncated or damaged: {_AGAIN}")
    return found[0], found[1]


def _tile_values(page: tifffile.TiffPage) -> int:
    """Return values in one tile or strip."""
    return math.prod(page.chunks if page.is_tiled else np.minimum(page.chunks, page.shape).tolist())


def _check_segments(path: Path, tiff: tifffile.TiffFile, page: tifffile.TiffPage) -> None:
    """Refuse a page whose segments hold less than it declares, or more than their strip."""
    if page.compression == _NOT_COMPRESSED:
        present = 4 * _tile_values(page) <= tiff.filehandle.size and sum(page.databytecounts) >= 4 * page.size
    elif page.compression in _ZLIB:
        limit = 4 * _tile_values(page)
        sizes = [
            _inflated_size(tiff, offset, count, limit)
            for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True)
        ]
        present = max(sizes) <= limit and sum(sizes) >= 4 * page.size
    else:
        present = False
    if not present:
        raise UnreadableResult(f"{path}: does not hold what it declares: {_AGAIN}")


def _inflated_size(tiff: tifffile.TiffFile, offset: int, count: int, limit: int) -> int:
    """Return the size of an inflated segment, bytes; a larger one counts as `limit` + 1."""
    tiff.filehandle.seek(offset)
    inflating, size = zlib.decompressobj(), 0
    waiting = tiff.filehandle.read(min(count, tiff.filehandle.size))
    while waiting and size <= limit:
        block = inflating.decompress(waiting, BLOCK_BYTES)
        if not block:
            break
        size += len(block)
        waiting = inflating.unconsumed_tail
    return min(size, limit + 1)
