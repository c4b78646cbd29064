"""Pictures and movies as files, in the format of their suffix, and matplotlib figures as PNG.

With the extra `movies` (PyAV) an MP4 holds VP9, which browsers play. Without it, MPEG-4 part 2: OpenCV includes its
encoder everywhere under a free licence; VLC, mpv, ffmpeg and the players of Linux and Windows show it, browsers do not.

matplotlib takes a while to load: it is imported where a figure is drawn.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Protocol, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from device.io.atomic import write_output
from device.surface import Float32Array, HeightMap, surface_slopes
from host_sync.errors import RenderError, ResultError
from host_sync.render.relief_sheet import MAX_COLUMNS
from host_sync.render.shading import (
    Picture,
    exaggeration_for,
    height_range_um,
    reduced,
    relief_rgb,
    shade,
    steep_slope,
    tint_table,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def figure_png(figure: Figure, dpi: float) -> bytes:
    """Return contents of a PNG without transparency; draws the figure at so many dots per inch."""
    _, data = cv2.imencode(".png", figure_pixels(figure, dpi)[..., ::-1])
    return data.tobytes()


def figure_pixels(figure: Figure, dpi: float) -> NDArray[np.uint8]:
    """Return a figure drawn at so many dots per inch: uint8 array of shape (H, W, 3), on its own opaque background."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(dpi)
    canvas: Any = FigureCanvasAgg(figure)  # without types
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def draw_relief(axes: Axes, height: HeightMap, title: str) -> None:
    """Draw the relief in `axes`, in millimetres on the skin, with its height scale beside it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize
    from matplotlib.figure import Figure

    small = reduced(height, MAX_COLUMNS)
    low_um, high_um = height_range_um(small)
    rows, columns = small.z_um.shape
    mm = small.pitch_um / 1000.0
    rgb = relief_rgb(small, low_um, high_um, exaggeration_for(steep_slope(small)))
    axes.imshow(rgb, extent=(0.0, columns * mm, rows * mm, 0.0), interpolation="nearest")
    axes.set_title(title)
    axes.set_xlabel("column, mm")
    axes.set_ylabel("row, mm")
    figure = axes.get_figure()
    if isinstance(figure, Figure):
        scale = ScalarMappable(Normalize(low_um, high_um), ListedColormap(tint_table() / 255.0))
        figure.colorbar(scale, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), label="height, µm")


DETAIL_PX: Final = 1600
SHOWN_SLOPE: Final = 0.25
"""RMS slope at which shading has good contrast."""


def exaggeration(height: HeightMap) -> float:
    """Return the factor on the heights that gives good contrast; at least 1. Detail is often only micrometres high."""
    p, q = surface_slopes(height)
    square = p**2 + q**2
    if not np.isfinite(square).any():
        return 1.0
    return max(1.0, SHOWN_SLOPE / max(float(np.sqrt(np.nanmean(square))), 1e-9))


def write_detail(path: Path, height: HeightMap, title: str) -> None:
    """Write the shaded detail as a PNG, in millimetres on the skin; invalid pixels are white."""
    from matplotlib.figure import Figure

    small = reduced(height, DETAIL_PX)
    factor = exaggeration(small)
    shading = shade(HeightMap(small.z_um * np.float32(factor), small.pitch_um))
    rows, columns = shading.shape
    mm = small.pitch_um / 1000.0
    figure = Figure(figsize=(10.0, 10.0 * rows / columns + 0.6), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(
        np.ma.masked_invalid(shading), cmap="gray", vmin=0.0, vmax=1.0, extent=(0.0, columns * mm, rows * mm, 0.0)
    )
    axes.set_title(f"{title}, heights x {factor:.3g}")
    axes.set_xlabel("column, mm")
    axes.set_ylabel("row, mm")
    figure.savefig(path, dpi=150)


TITLES: Final = ("frame", "quick look on the handheld", "relief", "± of the height, µm (k = 1)")
REDUCTION: Final = 2


@dataclass(frozen=True, eq=False)
class StoryRow:
    """A scan with what is shown of it.

    frame_rgb : float32 array of shape (H, W, 3), linear light as a fraction of full scale
    quick_look : uint8 array, the handheld's own picture
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height
    """

    title: str
    frame_rgb: Float32Array
    quick_look: NDArray[np.uint8]
    height: HeightMap
    sigma_um: Float32Array


def write_story(rows: Sequence[StoryRow], path: Path) -> None:
    """Write the picture, a row per scan."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(19.0, 4.0 * len(rows) + 0.3), layout="constrained")
    for number, (row, axes) in enumerate(zip(rows, figure.subplots(len(rows), 4, squeeze=False), strict=True)):
        frame, look, relief, sigma = axes
        frame.imshow(np.clip(1.3 * row.frame_rgb[::REDUCTION, ::REDUCTION], 0.0, 1.0) ** (1 / 2.2))
        look.imshow(row.quick_look, cmap="gray", vmin=0, vmax=255)
        draw_relief(relief, row.height, "")
        shown = sigma.imshow(row.sigma_um[::REDUCTION, ::REDUCTION], cmap="cividis", vmin=0.0)
        figure.colorbar(shown, cax=sigma.inset_axes((1.02, 0.0, 0.03, 1.0)))
        for one in (frame, look, sigma):
            one.set_xticks([])
            one.set_yticks([])
        for one, title in zip(axes, TITLES, strict=True):
            one.set_title(title if number == 0 else "")
        frame.set_ylabel(row.title)
    figure.savefig(path, dpi=100)


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
