"""A sequence of frames that share one calibration: a folder of files, a multi-page TIFF, or a movie.

Frames are decoded one by one on demand. An unreadable frame keeps its place in the sequence as a `BadFrame`, so that
later frames keep their time.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

import cv2
import msgspec
import numpy as np
import tifffile

from device.bundles.raw_frame import read_raw
from device.errors import RecordError
from device.imaging.flat_field import unbin_mosaic
from device.io.tiff import TIFF_READ_ERRORS, quiet_tiff_log
from hal.frame import RawFrame
from host_sync.errors import FrameSetError, SequenceError
from host_sync.frames.image_file import MAX_PIXELS, read_with_info
from host_sync.frames.image_info import (
    ORIENTATION_TAG,
    ImageInfo,
    Pixels,
    check_one_orientation,
    known_orientation,
    upright,
)
from host_sync.frames.tiff_file import promises_another_page

if TYPE_CHECKING:
    from device.bundles.scan import ScanBundle


DEFAULT_RATE_HZ: Final = 25.0
"""Frames a second of a recording that states no rate."""

TIMES_FILE: Final = "times.json"
"""File in a folder of recorded frames: the times at which they were taken."""

SUFFIXES: Final = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
_TIFF: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_RAW_PAGES: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class StoredFrame:
    """One frame as stored: RGB values, uint8 or uint16 array of shape (H, W, 3), or a raw frame.

    number : of the source's frames, from 0; None where every frame of it comes
    taken_ns : monotonic time at which it was taken, ns; None of a recorded one
    """

    name: str
    pixels: Pixels | RawFrame
    number: int | None = None
    taken_ns: int | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        rows, columns = self.pixels.shape[:2]
        return rows, columns


@dataclass(frozen=True, slots=True)
class BadFrame:
    """A frame that cannot be used, and the reason in one sentence; numbers as of `StoredFrame`."""

    name: str
    reason: str
    number: int | None = None
    taken_ns: int | None = None


class FrameSequence(Protocol):
    """Frames in order of time."""

    @property
    def count(self) -> int:
        """Number of frames, as the source states it."""

    @property
    def rate_hz(self) -> float | None:
        """Frames per second, or None where the source does not state it."""

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        """Yield all frames, each decoded on demand."""


def open_sequence(path: Path) -> FrameSequence:
    """Open a folder, a multi-page TIFF or a movie.

    Raises
    ------
    SequenceError
        It does not exist or holds no frames; names it.
    """
    try:
        if path.is_dir():
            return FolderSequence(path)
        with path.open("rb") as stream:
            start = stream.read(12)
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror}): name a folder of frames or a movie") from error
    if start[:4] in _TIFF:
        return StackSequence(path)
    if start[:4] == b"RIFF" or start[4:8] == b"ftyp" or start[:4] == b"\x1aE\xdf\xa3":
        return MovieSequence(path)
    raise SequenceError(f"{path}: is not a folder of frames, a multi-page TIFF or an AVI, MP4 or MKV movie")


def natural_order(path: Path) -> tuple[tuple[int, int | str], ...]:
    """Sort key that puts frame-2 before frame-10."""
    parts = re.split(r"(\d+)", path.name.casefold())
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in parts if part)


class FolderSequence:
    """Image files of a folder in natural order of their names: RGB images, or raw frames of a handheld."""

    def __init__(self, folder: Path) -> None:
        self._times_s = _recorded_times_s(folder)
        files = (entry for entry in folder.iterdir() if entry.suffix.lower() in SUFFIXES and entry.name[0] != ".")
        self._files = sorted(files, key=natural_order)
        if not self._files:
            raise SequenceError(f"{folder}: holds no PNG, TIFF or JPEG images: name the folder of the frames")

    @property
    def count(self) -> int:
        """Number of files."""
        return len(self._files)

    @property
    def rate_hz(self) -> float | None:
        """Mean rate of a recording; None of another folder."""
        lasting_s = self._times_s[-1] - self._times_s[0] if len(self._times_s) > 1 else 0.0
        return (len(self._times_s) - 1) / lasting_s if lasting_s > 0.0 else None

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        """Yield every file's frame."""
        first: dict[Path, ImageInfo] = {}
        known = len(self._times_s) == self.count
        for number, path in enumerate(self._files):
            taken_ns = round(1e9 * self._times_s[number]) if known else None
            try:
                info, pixels = _read_file(path)
                check_one_orientation(first | {path: info})
                first = first or {path: info}
                yield StoredFrame(path.name, pixels, taken_ns=taken_ns)
            except (FrameSetError, RecordError) as error:
                yield BadFrame(path.name, str(error), taken_ns=taken_ns)


class StackSequence:
    """Pages of a TIFF file, each an RGB image of 8 or 16 bit.

    Each page states where the next one begins. Of a truncated file, the pages that can be found come first, then one
    `BadFrame` for the rest, whose number is unknown.
    """

    rate_hz = None

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
                self._whole_pages = len(tiff.pages)
                self._is_cut = promises_another_page(tiff)
                first = tiff.pages.first
                shape, dtype = first.shape, first.dtype
        except TIFF_READ_ERRORS as error:
            raise SequenceError(f"{path}: is truncated or damaged: fetch it again") from error
        if len(shape) != 3 or shape[2] != 3 or dtype not in (np.uint8, np.uint16) or np.prod(shape[:2]) > MAX_PIXELS:
            raise SequenceError(f"{path}: pages hold {dtype} of shape {shape}: save RGB pages of 8 or 16 bit")
        self._shape, self._dtype = shape, dtype

    @property
    def count(self) -> int:
        """Number of pages; lost ones count as one."""
        return self._whole_pages + self._is_cut

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        """Yield every page's frame."""
        with quiet_tiff_log(), tifffile.TiffFile(self._path) as tiff:
            for number in range(self._whole_pages):
                name = f"page {number + 1}"
                try:
                    page = tiff.pages[number]
                    matches = page.shape == self._shape and page.dtype == self._dtype
                    turned = known_orientation(page.aspage().tags.valueof(ORIENTATION_TAG)) if matches else 0
                    pixels = upright(np.asarray(page.asarray(maxworkers=1)), turned) if matches else None
                except TIFF_READ_ERRORS:
                    pixels = None
                if pixels is None:
                    reason = "is damaged or differs from the first page: fetch the file again"
                    yield BadFrame(name, f"{self._path}: {name}: {reason}")
                else:
                    yield StoredFrame(name, pixels)
        if self._is_cut:
            rest = f"all after page {self._whole_pages}"
            yield BadFrame(rest, f"{self._path}: {rest} is missing, the file is cut short: fetch it again")


class MovieSequence:
    """Frames of a movie that OpenCV decodes: 8 bit, with the losses of its codec."""

    def __init__(self, path: Path) -> None:
        self._path = path
        movie = _opened(path)
        try:
            self.count = int(movie.get(cv2.CAP_PROP_FRAME_COUNT)) if movie.isOpened() else 0
            rate_hz = float(movie.get(cv2.CAP_PROP_FPS))
            size = movie.get(cv2.CAP_PROP_FRAME_WIDTH) * movie.get(cv2.CAP_PROP_FRAME_HEIGHT)
        finally:
            movie.release()
        if self.count < 1 or not 0 < size <= MAX_PIXELS:
            raise SequenceError(f"{path}: holds no frames that can be decoded: convert it, or fetch it again")
        self.rate_hz = rate_hz if 0.0 < rate_hz < 1e5 else None

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        """Yield every frame, R, G, B."""
        movie = _opened(self._path)
        try:
            for number in range(1, self.count + 1):
                found, pixels = movie.read()
                if not found:
                    rest = f"frame {number}" if number == self.count else f"frames {number} to {self.count}"
                    yield BadFrame(rest, f"{self._path}: {rest} cannot be decoded: fetch the file again")
                    return
                yield StoredFrame(f"frame {number}", np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), np.uint8))
        finally:
            movie.release()


class _Times(msgspec.Struct):
    times_s: list[float]


def _recorded_times_s(folder: Path) -> list[float]:
    """Return when each frame of a recording was taken; empty of another folder."""
    try:
        return msgspec.json.decode((folder / TIMES_FILE).read_bytes(), type=_Times).times_s
    except (OSError, msgspec.DecodeError):
        return []


def _opened(path: Path) -> cv2.VideoCapture:
    """Open the movie with the decoder's own messages silenced; errors are reported here instead."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.VideoCapture(str(path))
    finally:
        cv2.utils.logging.setLogLevel(level)


def _read_file(path: Path) -> tuple[ImageInfo, Pixels | RawFrame]:
    if path.exists() and not path.is_file():
        raise FrameSetError(f"{path}: is not a file: remove it from the folder")
    if path.suffix.lower() in (".tif", ".tiff") and _page_count(path) == _RAW_PAGES:
        raw = read_raw(path)
        return ImageInfo((raw.shape[0], raw.shape[1]), 3, 16, is_raw=True), raw
    info, pixels = read_with_info(path)
    if len(pixels.shape) != 3 and not isinstance(pixels, RawFrame):
        raise FrameSetError(f"{path}: is grey: a sequence takes RGB images")
    return info, pixels


def _page_count(path: Path) -> int:
    """Return pages of a TIFF; 0 when it cannot be read."""
    try:
        with quiet_tiff_log(), tifffile.TiffFile(path) as tiff:
            return len(tiff.pages)
    except TIFF_READ_ERRORS:
        return 0


# The movie of a scan's press as a sequence of frames of full size.


class BundleMovie:
    """Frames of half the size, each pixel of one colour four times, so that the scan's calibration reads them.

    Raises
    ------
    SequenceError
        The scan holds no movie.
    """

    def __init__(self, bundle: ScanBundle) -> None:
        movie = bundle.record.movie
        if movie is None:
            raise SequenceError(f"{bundle.scan_id}: holds no movie: scan with --capture movie, or name another scan")
        self._bundle, self._frames = bundle, movie.frames

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self._frames)

    @property
    def rate_hz(self) -> float | None:
        """Frames per second from the first to the last; None of a single frame."""
        lasting_ms = self._frames[-1].at_ms - self._frames[0].at_ms
        return 1e3 * (len(self._frames) - 1) / lasting_ms if lasting_ms > 0.0 else None

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        """Yield every frame."""
        for frame in self._frames:
            try:
                pixels = unbin_mosaic(self._bundle.movie_frame(frame.file))
                yield StoredFrame(frame.file, pixels, taken_ns=round(1e6 * frame.at_ms))
            except RecordError as error:
                yield BadFrame(frame.file, str(error), taken_ns=round(1e6 * frame.at_ms))
