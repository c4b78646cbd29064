"""Picture of a relief as in the paper's figures: diffuse, one light, from above, aslant or on a turntable."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np

from device.surface import Float32Array, HeightMap
from host_sync.errors import RenderError
from host_sync.kernels.jit import njit
from host_sync.render.picture_file import ReliefGif, ReliefMovie
from host_sync.render.relief_sheet import with_strip
from host_sync.render.shading import (
    AMBIENT,
    LIGHT_AZIMUTH_DEG,
    LIGHT_ELEVATION_DEG,
    Picture,
    ambient_occlusion,
    exaggeration_for,
    flat_brightness,
    height_range_um,
    shade,
    shadow_mask,
    steep_slope,
    tinted,
)

Colour = Literal["height", "white"]
MAX_PX: Final = 16_000


@dataclass(frozen=True, slots=True)
class Still:
    """Settings of a picture.

    columns : width, px
    viewpoint : None looks straight down, orthographic
    light_azimuth_deg : counter-clockwise from the right edge of the height map; 135 is the upper left
    exaggeration : factor on heights; None chooses one for good contrast
    range_um : heights of the first and last colour, µm; None takes those of the height map
    shadow, occlusion : whether the relief casts shadows, and occludes the sky
    """

    columns: int = 1600
    viewpoint: Viewpoint | None = None
    light_azimuth_deg: float = LIGHT_AZIMUTH_DEG
    light_elevation_deg: float = LIGHT_ELEVATION_DEG
    exaggeration: float | None = None
    colour: Colour = "height"
    shadow: bool = False
    occlusion: bool = False
    range_um: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Check the settings."""
        if not 16 <= self.columns <= MAX_PX:
            raise RenderError(f"a picture {self.columns} px wide cannot be made: choose 16 to {MAX_PX}")
        if not 0.0 < self.light_elevation_deg <= 90.0:
            raise RenderError("the light must be above the surface: choose an elevation above 0 and up to 90")
        if self.exaggeration is not None and not 0.0 < self.exaggeration <= 1e4:
            raise RenderError("the exaggeration must be above 0 and at most 10000")
        if self.range_um is not None and not self.range_um[0] < self.range_um[1]:
            raise RenderError("the range of colours must rise: give the lower height first")
        view = self.viewpoint
        angles_deg = (self.light_azimuth_deg, 0.0 if view is None else view.azimuth_deg)
        if not np.isfinite((*angles_deg, *(self.range_um or ()))).all():
            raise RenderError("azimuths and the range of colours must be numbers: choose finite ones")
        if view is not None and not (0.0 < view.elevation_deg <= 90.0 and 0.0 <= view.field_deg <= 120.0):
            raise RenderError(
                "the viewpoint must be above the surface: choose an elevation up to 90 and a field of at most 120"
            )


def render(height: HeightMap, still: Still) -> Picture:
    """Return the picture of shape (rows, columns, 3), white where nothing is visible.

    Raises
    ------
    RenderError
        The height map has no valid pixel.
    """
    small = resize_to_width(height, still.columns)
    colours = surface_colours(small, still)
    if still.viewpoint is None:
        rows = max(1, round(still.columns * small.z_um.shape[0] / small.z_um.shape[1]))
        if rows > small.z_um.shape[0]:
            return np.asarray(cv2.resize(colours, (still.columns, rows), interpolation=cv2.INTER_CUBIC), np.uint8)
        return np.asarray(cv2.resize(colours, (still.columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
    points = project(small, still.viewpoint, auto_exaggeration(small, still), OVERSAMPLING * still.columns)
    if max(points.shape) > 2 * MAX_PX:
        raise RenderError("the picture would be far higher than wide: choose a smaller exaggeration")
    return rasterize_mesh(points, colours)


def resize_to_width(height: HeightMap, columns: int) -> HeightMap:
    """Return the height map averaged to the picture's width; invalid pixels do not spread.

    Raises
    ------
    RenderError
        It has no valid pixel.
    """
    known = np.isfinite(height.z_um)
    if not known.any():
        raise RenderError("the height map has no valid pixel: there is nothing to draw")
    rows, whole = height.z_um.shape
    if whole <= columns:
        return height
    size = (columns, max(2, round(rows * columns / whole)))
    weight = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(known, height.z_um, np.float32(0.0)), size, interpolation=cv2.INTER_AREA)
    z_um = np.where(weight > 0.5, total / np.maximum(weight, np.float32(1e-6)), np.float32(np.nan))
    return HeightMap(z_um.astype(np.float32), height.pitch_um * whole / columns)


def auto_exaggeration(height: HeightMap, still: Still) -> float:
    """Return the factor on heights of a picture."""
    return still.exaggeration or exaggeration_for(steep_slope(height))


def surface_colours(height: HeightMap, still: Still) -> Picture:
    """Return the colour of every pixel under the picture's light: uint8 array of shape (H, W, 3)."""
    factor = auto_exaggeration(height, still)
    brightness = shade(height, still.light_azimuth_deg, still.light_elevation_deg, factor)
    brightness = _occluded(height, still, factor, brightness)
    if still.colour == "height":
        flat = flat_brightness(still.light_elevation_deg)
        return tinted(height, brightness, flat, *(still.range_um or height_range_um(height)))
    grey = np.round(255.0 * np.nan_to_num(np.clip(brightness, 0.0, 1.0), nan=1.0)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _occluded(height: HeightMap, still: Still, factor: float, brightness: Float32Array) -> Float32Array:
    """Return the brightness with shadows and occlusion."""
    if still.shadow:
        share = shadow_mask(height, factor, still.light_azimuth_deg, still.light_elevation_deg)
        brightness = np.float32(AMBIENT) + (brightness - np.float32(AMBIENT)) * share
    if still.occlusion:
        brightness = brightness * (0.35 + 0.65 * ambient_occlusion(height, factor))
    return np.asarray(brightness, np.float32)


MARGIN: Final = 1.04
"""Size of the picture over that of its content."""


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """A viewing direction.

    azimuth_deg : azimuth of the eye, counter-clockwise from the right edge of the height map; 270 is in front
    elevation_deg : elevation of the eye above the plane; 90 looks straight down
    field_deg : field of view; 0 is orthographic, as in the paper
    """

    azimuth_deg: float = 300.0
    elevation_deg: float = 40.0
    field_deg: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """A height map's points on the picture.

    x, y : float32 arrays of shape (H, W), px from the left and from the top
    depth : float32 array of shape (H, W), larger is farther
    shape : (rows, columns) of the picture
    """

    x: Float32Array
    y: Float32Array
    depth: Float32Array
    shape: tuple[int, int]


def project(
    height: HeightMap, viewpoint: Viewpoint, exaggeration: float, columns: int, shape: tuple[int, int] | None = None
) -> Projected:
    """Return the points of a height map on a picture `columns` wide that fits it; NaN where invalid.

    shape : (rows, columns) of the picture when it is fixed for all azimuths, as in a turntable
    """
    right, up, away = _in_eye(height, viewpoint, exaggeration)
    if viewpoint.field_deg > 0.0:
        extent = float(np.hypot(*height.z_um.shape)) * height.pitch_um / 2.0
        far = extent / np.tan(np.radians(viewpoint.field_deg) / 2.0) + extent
        nearer = far / np.maximum(far + away, 0.05 * far)
        right, up = right * nearer, up * nearer
    if shape is None:
        spans = [float(np.nanmax(part) - np.nanmin(part)) for part in (right, up)]
        middle = [float(np.nanmax(part) + np.nanmin(part)) / 2.0 for part in (right, up)]
        scale = columns / (MARGIN * max(spans[0], 1e-9))
        rows = max(2, round(MARGIN * spans[1] * scale))
    else:
        rows, columns = shape
        middle = [0.0, 0.0]
        scale = columns / (MARGIN * float(np.hypot(*height.z_um.shape)) * height.pitch_um)
    return Projected(
        x=np.asarray((right - middle[0]) * scale + 0.5 * columns, np.float32),
        y=np.asarray(0.5 * rows - (up - middle[1]) * scale, np.float32),
        depth=np.asarray(away * scale, np.float32),
        shape=(rows, columns),
    )


def _in_eye(
    height: HeightMap, viewpoint: Viewpoint, exaggeration: float
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return the coordinates of each point right of, above and behind the map's centre, as seen, µm."""
    turn, rise = np.radians([viewpoint.azimuth_deg, viewpoint.elevation_deg])
    rows, columns = height.z_um.shape
    x = ((np.arange(columns) - 0.5 * (columns - 1)) * height.pitch_um).astype(np.float32)[None, :]
    y = ((0.5 * (rows - 1) - np.arange(rows)) * height.pitch_um).astype(np.float32)[:, None]
    finite = height.z_um[np.isfinite(height.z_um)]
    middle = 0.5 * (float(finite.min()) + float(finite.max())) if finite.size else 0.0
    z = (height.z_um - np.float32(middle)) * np.float32(exaggeration)
    right = -np.sin(turn) * x + np.cos(turn) * y + np.float32(0.0) * z
    towards = np.cos(turn) * x + np.sin(turn) * y
    up = -np.sin(rise) * towards + np.cos(rise) * z
    away = -np.cos(rise) * towards - np.sin(rise) * z
    return right.astype(np.float32), up.astype(np.float32), away.astype(np.float32)


OVERSAMPLING: Final = 2


def rasterize_mesh(points: Projected, colours: Picture, background: tuple[int, int, int] = (255, 255, 255)) -> Picture:
    """Return the picture of shape (rows, columns, 3) of the surface between the points.

    points : their positions on a picture `OVERSAMPLING` times as large in each direction
    colours : uint8 array of shape (H, W, 3), R, G, B of each point
    """
    rows, columns = points.shape
    large = np.empty((rows, columns, 3), np.uint8)
    large[:] = background
    nearest = np.full((rows, columns), np.inf, np.float32)
    _draw(points.x, points.y, points.depth, np.ascontiguousarray(colours), nearest, large)
    size = (max(1, columns // OVERSAMPLING), max(1, rows // OVERSAMPLING))
    return np.asarray(cv2.resize(large, size, interpolation=cv2.INTER_AREA), np.uint8)


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(x: Any, y: Any, depth: Any, colours: Any, nearest: Any, picture: Any) -> None:
    """Draw two triangles per cell, where their corners are valid."""
    rows, columns = x.shape
    for r in range(rows - 1):
        for c in range(columns - 1):
            _triangle(x, y, depth, colours, r, c, r + 1, c, r, c + 1, nearest, picture)
            _triangle(x, y, depth, colours, r + 1, c + 1, r, c + 1, r + 1, c, nearest, picture)


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle(
    x: Any, y: Any, depth: Any, colours: Any,
    ra: Any, ca: Any, rb: Any, cb: Any, rc: Any, cc: Any,
    nearest: Any, picture: Any,
) -> None:  # fmt: skip
    """One triangle, its colour between those of its corners."""
    xa, ya, xb, yb, xc, yc = x[ra, ca], y[ra, ca], x[rb, cb], y[rb, cb], x[rc, cc], y[rc, cc]
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    if not np.isfinite(area) or area == 0.0:
        return
    rows, columns = nearest.shape
    top = max(int(np.ceil(min(ya, yb, yc) - 0.5)), 0)
    bottom = min(int(np.floor(max(ya, yb, yc) - 0.5)), rows - 1)
    left = max(int(np.ceil(min(xa, xb, xc) - 0.5)), 0)
    right = min(int(np.floor(max(xa, xb, xc) - 0.5)), columns - 1)
    for row in range(top, bottom + 1):
        py = row + np.float32(0.5)
        for column in range(left, right + 1):
            px = column + np.float32(0.5)
            b = ((px - xa) * (yc - ya) - (xc - xa) * (py - ya)) / area
            c = ((xb - xa) * (py - ya) - (px - xa) * (yb - ya)) / area
            a = np.float32(1.0) - b - c
            if a < -1e-5 or b < -1e-5 or c < -1e-5:
                continue
            far = a * depth[ra, ca] + b * depth[rb, cb] + c * depth[rc, cc]
            if far < nearest[row, column]:
                nearest[row, column] = far
                for k in range(3):
                    mixed = a * colours[ra, ca, k] + b * colours[rb, cb, k] + c * colours[rc, cc, k]
                    picture[row, column, k] = np.uint8(min(max(mixed, 0.0), 255.0) + 0.5)


FRAMES: Final = 120
RATE_HZ: Final = 24.0


def turning_pictures(height: HeightMap, still: Still, frames: int = FRAMES) -> Iterator[Picture]:
    """Yield pictures of one size, with an even number of rows and columns, from all directions."""
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
