"""Light on the skin: near point lights, fall-off, cosine law, metal flakes, cast shadows. Physics, no fitted model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from hal.simulator.arrays import Float32Array, FloatArray
from hal.simulator.lens import Lens

UNIT_DISTANCE_MM: Final = 25.0
"""Distance of the light at which a white skin facing it has radiance 1."""


@dataclass(frozen=True, slots=True)
class Coat:
    """Reflectance of the skin: a Lambertian part, and flakes that scatter about the surface normal.

    flake_fraction : 0 for a diffuse skin
    lobe_half_width_rad : angle between normal and half vector at which the lobe of the flakes has fallen to one half
    """

    flake_fraction: float
    lobe_half_width_rad: float


_COATS: Final[dict[str, Coat]] = {
    "diffuse": Coat(0.0, 1.0),
    "flake": Coat(0.5, float(np.radians(20.0))),
    "sharp-flake": Coat(0.5, float(np.radians(8.0))),
}


def coat(name: str) -> Coat:
    """The coat of that name in a board profile."""
    return _COATS[name]


@dataclass(frozen=True, slots=True, eq=False)
class SkinGeometry:
    """Points (mm) and unit normals of the skin, float32 arrays of shape (H, W)."""

    x_mm: Float32Array
    y_mm: Float32Array
    z_mm: Float32Array
    normal_x: Float32Array
    normal_y: Float32Array
    normal_z: Float32Array


def skin_geometry(lens: Lens, height_mm: FloatArray) -> SkinGeometry:
    """Points and normals of a skin from its height on the pixel grid, array of shape (H, W), mm."""
    x, y = lens.points_mm(height_mm)
    slope_x, slope_y = lens.skin_slopes(height_mm)
    up = 1.0 / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    arrays = (x, y, height_mm, -slope_x * up, -slope_y * up, up)
    return SkinGeometry(*(np.asarray(a, np.float32) for a in arrays))


def radiance(
    skin: SkinGeometry, lens: Lens, skin_coat: Coat, light_mm: tuple[float, float, float], light_radius_mm: float
) -> Float32Array:
    """Radiance of the skin towards the camera under one light, float32 array of shape (H, W)."""
    away = [np.float32(at) - here for at, here in zip(light_mm, (skin.x_mm, skin.y_mm, skin.z_mm), strict=True)]
    squared = away[0] ** 2 + away[1] ** 2 + away[2] ** 2
    inverse = 1.0 / np.sqrt(squared)
    to_light = [a * inverse for a in away]
    normal = (skin.normal_x, skin.normal_y, skin.normal_z)
    cosine = np.maximum(sum(n * a for n, a in zip(normal, to_light, strict=True)), np.float32(0.0))
    reflected = cosine * np.float32(1.0 - skin_coat.flake_fraction)
    if skin_coat.flake_fraction > 0.0:
        reflected = reflected + np.float32(skin_coat.flake_fraction) * _flakes(skin, lens, skin_coat, to_light, cosine)
    seen = visible_fraction(skin.z_mm, lens.pitch_mm, light_mm, light_radius_mm)
    return np.asarray(reflected * seen * np.float32(UNIT_DISTANCE_MM**2) / squared, np.float32)


def _flakes(
    skin: SkinGeometry, lens: Lens, skin_coat: Coat, to_light: list[FloatArray], cosine: FloatArray
) -> FloatArray:
    """Lobe of the flakes, array of shape (H, W): 1 where the normal halves the angle between light and camera."""
    to_camera = (-skin.x_mm, -skin.y_mm, np.float32(lens.distance_mm) - skin.z_mm)
    inverse = 1.0 / np.sqrt(sum(v**2 for v in to_camera))
    half = [a + v * inverse for a, v in zip(to_light, to_camera, strict=True)]
    length = np.sqrt(sum(h**2 for h in half))
    normal = (skin.normal_x, skin.normal_y, skin.normal_z)
    aligned = sum(n * h for n, h in zip(normal, half, strict=True)) / length
    angle = np.arccos(np.clip(aligned, -1.0, 1.0))
    lobe = np.exp(np.float32(-np.log(2.0)) * (angle / np.float32(skin_coat.lobe_half_width_rad)) ** 2)
    # Flakes shadow each other at grazing incidence.
    return lobe * (cosine / (cosine + np.float32(0.1)))


_GRID_CELLS: Final = 100_000
"""Size of the reduced grid on which cast shadows are computed."""


def visible_fraction(
    height_mm: FloatArray, pitch_mm: float, light_mm: tuple[float, float, float], light_radius_mm: float
) -> Float32Array:
    """Fraction of the light's disc visible from each point, float32 array of the shape of `height_mm`, 0 to 1."""
    rows, columns = height_mm.shape
    reduction = max(1, round((rows * columns / _GRID_CELLS) ** 0.5))
    size = (max(columns // reduction, 2), max(rows // reduction, 2))
    small = np.asarray(cv2.resize(np.asarray(height_mm, np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
    fraction = _march(small, pitch_mm * columns / size[0], light_mm, light_radius_mm)
    return np.asarray(cv2.resize(fraction, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)


def _march(
    height: Float32Array, cell_mm: float, light_mm: tuple[float, float, float], light_radius_mm: float
) -> Float32Array:
    """Walk from every cell towards the light; keep the smallest angle by which its ray clears the skin."""
    rows, columns = height.shape
    row, column = np.mgrid[:rows, :columns].astype(np.float32)
    away_x = np.float32(light_mm[0]) - (column - (columns - 1) / 2) * np.float32(cell_mm)
    away_y = np.float32(light_mm[1]) - (row - (rows - 1) / 2) * np.float32(cell_mm)
    across = np.hypot(away_x, away_y)
    rise = (np.float32(light_mm[2]) - height) / across
    step_column, step_row = away_x / across, away_y / across
    clearance = np.full_like(height, np.inf)
    reach_cells = float(np.ptp(height)) / float(rise.min()) / cell_mm + 2.0
    # The nearest cells are left to the cosine law: there the steps of the grid itself would cast shadows.
    for cells in np.arange(2.0, reach_cells + 1.0, 1.0, dtype=np.float32):
        met = cv2.remap(
            height,
            column + cells * step_column,
            row + cells * step_row,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        np.minimum(clearance, rise + (height - met) / (cells * np.float32(cell_mm)), out=clearance)
    half_angle = np.float32(light_radius_mm) / np.hypot(across, np.float32(light_mm[2]) - height)
    return np.asarray(np.clip(0.5 + 0.5 * clearance / half_angle, 0.0, 1.0), np.float32)
