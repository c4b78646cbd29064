"""Pictures and movies as files, in the format of their suffix.

With the extra `movies` (PyAV) an MP4 holds VP9, which browsers play. Without it, MPEG-4 part 2: OpenCV includes its
encoder everywhere under a free licence; VLC, mpv, ffmpeg and the players of Linux and Windows show it, browsers do not.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol, Self

import cv2
import numpy as np
from PIL import Image

from device.io.atomic import write_output
from host_sync.errors import RenderError, ResultError
from host_sync.render.shading import Picture

SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
MAX_STEM: Final = 80


def write_any_picture(path: Path, picture: Picture) -> None:
    """Write a picture of shape (H, W, 3) in the format of the suffix.

    Raises
    ------
    RenderError
        The suffix is not supported.
    ResultError
        The place cannot be written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise RenderError(f"{path}: is not a picture format: use .png, .jpg, .tif or .webp")
    made, data = cv2.imencode(path.suffix.lower(), picture[..., ::-1])
    if not made:
        raise RenderError(f"{path}: the picture is too large for this format: choose .png or a smaller --width")
    make_folder(path.parent)
    write_output(path, data.tobytes())


def make_folder(folder: Path) -> None:
    """Make a folder and those above it.

    Raises
    ------
    ResultError
        It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(f"{folder} cannot be made ({error.strerror or error}): choose another place") from error


def file_stems(titles: Sequence[str]) -> list[str]:
    """Return a file name without suffix for each title: letters, digits, . _ and - only, all different."""
    stems: list[str] = []
    for title in titles:
        stem = re.sub(r"[^\w.-]+", "-", title, flags=re.ASCII).strip("-.")[:MAX_STEM] or "relief"
        number, unique = 2, stem
        while unique in stems:
            unique, number = f"{stem}-{number}", number + 1
        stems.append(unique)
    return stems


MAX_RATE_HZ: Final = 60.0
"""Frames of faster sequences are skipped: neither screens nor players can show them."""

GIF_RATE_HZ: Final = 12.5
GIF_FRAMES: Final = 200
GIF_MAX_COLUMNS: Final = 480
"""Most frames and columns of a GIF, which compresses poorly."""

_PALETTE_FRAMES: Final = 8
VP9: Final = {"deadline": "realtime", "cpu-used": "8", "row-mt": "1", "crf": "31", "b": "0"}
WEBP: Final = {"quality": 82, "method": 2}


def plays_in_browser() -> bool:
    """Return whether MP4 files that are written here play in browsers: the extra `movies` is installed."""
    return _library() is not None


def _library() -> Any:
    """PyAV, or None without it."""
    try:
        import av
    except ImportError:
        return None
    return av


class _Encoder(Protocol):
    def append(self, picture: Picture) -> None: ...

    def close(self) -> None: ...


class _BrowserEncoder:
    """VP9 through PyAV."""

    def __init__(self, library: Any, path: Path, shape: tuple[int, int], rate_hz: float) -> None:
        self._library = library
        self._container = library.open(str(path), "w")
        self._stream = self._container.add_stream("libvpx-vp9", rate=Fraction(rate_hz).limit_denominator(1000))
        self._stream.height, self._stream.width = shape
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = VP9

    def append(self, picture: Picture) -> None:
        frame = self._library.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()


class _PlainEncoder:
    """MPEG-4 part 2 through OpenCV."""

    def __init__(self, path: Path, shape: tuple[int, int], rate_hz: float) -> None:
        rows, columns = shape
        code = cv2.VideoWriter.fourcc(*"mp4v")
        self._movie = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, rate_hz, (columns, rows))
        if not self._movie.isOpened():
            raise OSError

    def append(self, picture: Picture) -> None:
        self._movie.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))

    def close(self) -> None:
        self._movie.release()


class ReliefMovie:
    """Writes pictures of one size as an MP4; a context manager.

    Parameters
    ----------
    path : the file to write
    shape : (H, W) of the pictures, even
    rate_hz : pictures per second

    Raises
    ------
    ResultError
        The movie cannot be written.
    """

    def __init__(self, path: Path, shape: tuple[int, int], rate_hz: float) -> None:
        self._path = path
        library = _library()
        try:
            self._movie: _Encoder = (
                _PlainEncoder(path, shape, rate_hz)
                if library is None
                else _BrowserEncoder(library, path, shape, rate_hz)
            )
        except OSError as error:
            raise ResultError(
                f"{path}: the movie cannot be written: choose another folder, or --no-mp4 and --no-gif"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._movie.close()
        except OSError as failed:
            if kind is None:
                raise ResultError(f"{self._path}: the movie could not be written: free space on the disk") from failed
        if kind is None and (not self._path.is_file() or not self._path.stat().st_size):
            raise ResultError(f"{self._path}: the movie could not be written: free space, or choose another folder")

    def append(self, picture: Picture) -> None:
        """Encode the next picture: uint8 array of shape (H, W, 3), R, G, B."""
        self._movie.append(picture)


class ReliefGif:
    """Collects a subset of a movie's pictures, reduced, and writes them as a looping GIF or WebP.

    Parameters
    ----------
    count : number of pictures in the movie
    rate_hz : its pictures per second
    """

    def __init__(self, count: int, rate_hz: float) -> None:
        self._every = max(1, -(-count // GIF_FRAMES), round(rate_hz / GIF_RATE_HZ))
        self._duration_ms = 10 * max(2, round(100.0 * self._every / rate_hz))
        self._frames: list[Image.Image] = []

    def append(self, number: int, picture: Picture) -> None:
        """Take or skip the picture of this number."""
        if number % self._every:
            return
        rows, columns = picture.shape[:2]
        factor = min(1.0, GIF_MAX_COLUMNS / columns)
        size = (round(columns * factor), round(rows * factor))
        small = Image.fromarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
        self._frames.append(small)

    def write(self, path: Path) -> None:
        """Write the file, by its suffix.

        Raises
        ------
        OSError
            The disk refused.
        """
        if path.suffix.lower() == ".webp":
            first, *others = self._frames
            first.save(path, "WEBP", save_all=True, append_images=others, duration=self._duration_ms, loop=0, **WEBP)
            return
        palette = self._palette()
        first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in self._frames)
        first.save(path, save_all=True, append_images=others, duration=self._duration_ms, loop=0, optimize=False)

    def _palette(self) -> Image.Image:
        """Return a palette for all frames, made from some of them."""
        some = self._frames[:: max(1, len(self._frames) // _PALETTE_FRAMES)]
        rows = np.concatenate([np.asarray(frame)[::2, ::2] for frame in some])
        return Image.fromarray(rows).quantize(256)
