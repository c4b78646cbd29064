"""A relief on a turntable: the viewpoint moves around it, the light stays fixed to the relief."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from device.surface.fields import HeightMap
from host_sync.errors import RenderError
from host_sync.render.colour_strip import with_strip
from host_sync.render.relief import Picture, height_range_um
from host_sync.render.relief_movie import ReliefGif, ReliefMovie
from host_sync.render.still import Still, auto_exaggeration, resize_to_width, surface_colours
from host_sync.render.viewpoint import Viewpoint, project
from host_sync.render.z_buffer import OVERSAMPLING, rasterize_mesh

FRAMES: Final = 120
RATE_HZ: Final = 24.0


def turning_pictures(height: HeightMap, still: Still, frames: int = FRAMES) -> Iterator[Picture]:
    """Pictures of one size, with an even number of rows and columns, from all directions."""
    small = resize_to_width(height, still.columns)
    colours = surface_colours(small, still)
    view = still.viewpoint or Viewpoint()
    factor = auto_exaggeration(small, still)
    range_um = still.range_um or height_range_um(small)
    shape = _shape(small, view, factor, still.columns)
    for number in range(frames):
        seen = replace(view, azimuth_deg=view.azimuth_deg + 360.0 * number / frames)
        points = project(small, seen, factor, shape[1], shape=shape)
        picture = rasterize_mesh(points, colours)
        yield with_strip(picture, range_um) if still.colour == "height" else picture


def write_turntable(
    path: Path,
    height: HeightMap,
    still: Still,
    frames: int = FRAMES,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> None:
    """Write the turntable as .mp4, .gif or .webp, by the suffix.

    Raises
    ------
    RenderError
        The suffix is neither.
    ResultError, OSError
        The file cannot be written.
    """
    suffix = path.suffix.lower()
    pictures = turning_pictures(height, still, frames)
    if suffix in {".gif", ".webp"}:
        gif = ReliefGif(frames, RATE_HZ)
        for number, picture in enumerate(pictures):
            gif.append(number, picture)
            progress(number + 1, frames)
        gif.write(path)
    elif suffix == ".mp4":
        first = next(pictures)
        with ReliefMovie(path, first.shape[:2], RATE_HZ) as movie:
            movie.append(first)
            for number, picture in enumerate(pictures, start=1):
                movie.append(picture)
                progress(number + 1, frames)
    else:
        raise RenderError(f"{path}: a turntable is written as .mp4, .gif or .webp: choose one")


def _shape(height: HeightMap, view: Viewpoint, factor: float, columns: int) -> tuple[int, int]:
    """(rows, columns) of the oversampled picture that shows the relief from all sides."""
    rise = np.radians(view.elevation_deg)
    diagonal = float(np.hypot(*height.z_um.shape)) * height.pitch_um
    tall = (float(np.nanmax(height.z_um)) - float(np.nanmin(height.z_um))) * factor
    share = float(np.sin(rise)) + float(np.cos(rise)) * tall / diagonal
    even = 2 * OVERSAMPLING
    return max(even, round(OVERSAMPLING * columns * share / even) * even), columns // 2 * even
