"""Picture of a relief as in the paper's figures: diffuse, one light, from above or another viewpoint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from device.surface.fields import Float32Array, HeightMap
from host_sync.errors import RenderError
from host_sync.render.occlusion import ambient_occlusion, shadow_mask
from host_sync.render.relief import Picture, height_range_um, tinted
from host_sync.render.shading import (
    AMBIENT,
    LIGHT_AZIMUTH_DEG,
    LIGHT_ELEVATION_DEG,
    exaggeration_for,
    flat_brightness,
    shade,
    steep_slope,
)
from host_sync.render.viewpoint import Viewpoint, project
from host_sync.render.z_buffer import OVERSAMPLING, rasterize_mesh

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
        if view is not None and not (0.0 < view.elevation_deg <= 90.0 and 0.0 <= view.field_deg <= 120.0):
            raise RenderError(
                "the viewpoint must be above the surface: choose an elevation up to 90 and a field of at most 120"
            )


def render(height: HeightMap, still: Still) -> Picture:
    """Picture of shape (rows, columns, 3), white where nothing is visible.

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
    """The height map averaged to the picture's width; invalid pixels do not spread.

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
    """The factor on heights of a picture."""
    return still.exaggeration or exaggeration_for(steep_slope(height))


def surface_colours(height: HeightMap, still: Still) -> Picture:
    """Colour of every pixel under the picture's light: uint8 array of shape (H, W, 3)."""
    factor = auto_exaggeration(height, still)
    brightness = shade(height, still.light_azimuth_deg, still.light_elevation_deg, factor)
    brightness = _occluded(height, still, factor, brightness)
    if still.colour == "height":
        flat = flat_brightness(still.light_elevation_deg)
        return tinted(height, brightness, flat, *(still.range_um or height_range_um(height)))
    grey = np.round(255.0 * np.nan_to_num(np.clip(brightness, 0.0, 1.0), nan=1.0)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _occluded(height: HeightMap, still: Still, factor: float, brightness: Float32Array) -> Float32Array:
    """The brightness with shadows and occlusion."""
    if still.shadow:
        share = shadow_mask(height, factor, still.light_azimuth_deg, still.light_elevation_deg)
        brightness = np.float32(AMBIENT) + (brightness - np.float32(AMBIENT)) * share
    if still.occlusion:
        brightness = brightness * (0.35 + 0.65 * ambient_occlusion(height, factor))
    return np.asarray(brightness, np.float32)
