"""The raw frame on disk: a lossless TIFF of its four Bayer planes that any TIFF reader opens.

Page i holds the pixels at (i // 2, i % 2) of every 2x2 block. The first page's description is JSON: how the frame was
taken, and a CRC of its counts, so that damage shows even outside the bundle.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, BinaryIO, Final

import msgspec
import numpy as np
import tifffile
from numpy.typing import NDArray

from device.bundles.record import Nanoseconds, NotNegative, Positive, Record, decode_record
from device.errors import RecordError
from device.io.folder import Folder, open_regular
from device.io.tiff import TIFF_READ_ERRORS, check_pixel_count, quiet_tiff_log
from hal.frame import BayerOrder, CameraSettings, RawFrame

RAW_SCHEMA: Final = "retrograph.raw/1"
ZSTD_LEVEL: Final = 1
HORIZONTAL_DIFFERENCES: Final = 2
"""TIFF's predictor 2: frames with varying brightness shrink by a sixth at no cost in time."""

MAX_SIDE_PX: Final = 16384

Side = Annotated[int, msgspec.Meta(ge=2, le=MAX_SIDE_PX, multiple_of=2)]


class RawHeader(Record, frozen=True, tag_field="schema", tag=RAW_SCHEMA):
    """Settings of a raw frame; levels in dn; `crc32` covers the four planes' little-endian counts in page order."""

    bayer_order: BayerOrder
    rows: Side
    columns: Side
    black_level_dn: NotNegative
    white_level_dn: Positive
    exposure_us: Positive
    analogue_gain: Positive
    sensor_timestamp_ns: Nanoseconds
    crc32: Annotated[int, msgspec.Meta(ge=0, lt=1 << 32)]


def write_raw(path: Path, frame: RawFrame) -> None:
    """Write a frame losslessly; the store makes it durable."""
    planes = _planes(frame.mosaic)
    rows, columns = frame.shape
    header = RawHeader(
        bayer_order=frame.bayer_order,
        rows=rows,
        columns=columns,
        black_level_dn=float(frame.black_level_dn),
        white_level_dn=float(frame.white_level_dn),
        exposure_us=float(frame.granted.exposure_us),
        analogue_gain=float(frame.granted.analogue_gain),
        sensor_timestamp_ns=int(frame.sensor_timestamp_ns),
        crc32=zlib.crc32(planes.data),
    )
    tifffile.imwrite(
        path,
        planes,
        byteorder="<",
        photometric="minisblack",
        compression="zstd",
        compressionargs={"level": ZSTD_LEVEL},
        predictor=HORIZONTAL_DIFFERENCES,
        maxworkers=1,
        metadata=None,
        software="retrograph",
        description=msgspec.json.encode(header).decode(),
    )


def read_raw(path: Path, shape: tuple[int, int] | None = None) -> RawFrame:
    """Return the frame in a file that the user named, of `shape` (H, W) when it is known; nothing else is decompressed.

    Raises
    ------
    RecordError
        The file is missing, damaged, not a raw frame, or of another size; names it.
    """
    return _read(path, lambda: os.fdopen(open_regular(path, follow=True), "rb"), shape)


def read_bundle_frame(path: Path, shape: tuple[int, int]) -> RawFrame:
    """Return the frame in a file of a bundle, of `shape` (H, W) as its record states; links are not followed.

    Errors as for `read_raw`.
    """
    with ExitStack() as stack:

        def opened() -> BinaryIO:
            folder = stack.enter_context(Folder(path.parent, follow=False))
            return stack.enter_context(folder.opened(path.name))

        return _read(path, opened, shape)


def _read(path: Path, opened: Callable[[], BinaryIO], shape: tuple[int, int] | None) -> RawFrame:
    try:
        with opened() as stream, quiet_tiff_log(), tifffile.TiffFile(stream, name=path.name) as tiff:
            header = decode_record(tiff.pages.first.description.encode(), RawHeader, path)
            _check_size(header, shape, path)
            planes = _read_planes(tiff, header, path)
    except RecordError:
        raise
    except FileNotFoundError as error:
        raise RecordError(f"{path}: is missing: fetch the bundle again") from error
    except TIFF_READ_ERRORS as error:
        raise RecordError(f"{path}: cannot be read as a raw frame, it is damaged: fetch it again") from error
    if zlib.crc32(planes.data) != header.crc32:
        raise RecordError(f"{path}: is damaged (the CRC of its counts differs): fetch it again")
    mosaic = np.empty((header.rows, header.columns), np.uint16)
    for site, plane in enumerate(planes):
        mosaic[site // 2 :: 2, site % 2 :: 2] = plane
    return RawFrame(
        mosaic=mosaic,
        bayer_order=header.bayer_order,
        black_level_dn=header.black_level_dn,
        white_level_dn=header.white_level_dn,
        granted=CameraSettings(header.exposure_us, header.analogue_gain),
        sensor_timestamp_ns=header.sensor_timestamp_ns,
    )


def _planes(mosaic: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return the mosaic's four sites: uint16 array of shape (4, H / 2, W / 2)."""
    rows, columns = mosaic.shape
    if rows % 2 or columns % 2:
        raise ValueError(f"a mosaic of {columns}x{rows} pixels does not consist of 2x2 blocks")
    return np.stack([mosaic[site // 2 :: 2, site % 2 :: 2] for site in range(4)]).astype("<u2", copy=False)


def _check_size(header: RawHeader, expected: tuple[int, int] | None, path: Path) -> None:
    """Refuse a frame by what its header declares, before anything is decoded."""
    found = (header.rows, header.columns)
    if expected is not None and found != expected:
        raise RecordError(f"{path}: is {found} pixels (rows, columns), not {expected} as recorded: fetch it again")
    try:
        check_pixel_count(found)
    except ValueError as error:
        raise RecordError(f"{path}: {error}: fetch it again") from error


def _read_planes(tiff: tifffile.TiffFile, header: RawHeader, path: Path) -> NDArray[np.uint16]:
    """Return the four pages, compared with the header before anything is decompressed."""
    shape = (header.rows // 2, header.columns // 2)
    pages = [tiff.pages[site] for site in range(4)]
    # The chain of pages can be as long as the file: only the first five are followed.
    if _has_page(tiff, 4) or any(
        page.shape != shape or page.dtype != np.uint16 or page.compression != tifffile.COMPRESSION.ZSTD
        for page in pages
    ):
        raise RecordError(f"{path}: its pages are not four planes of {shape[1]}x{shape[0]} with zstd: fetch it again")
    return np.stack([page.asarray(maxworkers=1) for page in pages]).astype("<u2", copy=False)


def _has_page(tiff: tifffile.TiffFile, index: int) -> bool:
    try:
        tiff.pages[index]
    except IndexError:
        return False
    return True
