"""Cast shadows: how much of a light each point of the skin sees past the skin itself."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from hal.twin.arrays import Float32Array, FloatArray

_GRID_CELLS: Final = 100_000
"""Size of the reduced grid on which the skin is searched for what hides the light."""


def visible_share(
    height_mm: FloatArray, pitch_mm: float, light_mm: tuple[float, float, float], light_radius_mm: float
) -> Float32Array:
    """Share of the light's disc that each point sees, float32 array of the shape (H, W) of `height_mm`, 0 to 1."""
    rows, columns = height_mm.shape
    reduction = max(1, round((rows * columns / _GRID_CELLS) ** 0.5))
    size = (max(columns // reduction, 2), max(rows // reduction, 2))
    small = np.asarray(cv2.resize(np.asarray(height_mm, np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
    share = _march(small, pitch_mm * columns / size[0], light_mm, light_radius_mm)
    return np.asarray(cv2.resize(share, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)


def _march(
    height: Float32Array, cell_mm: float, light_mm: tuple[float, float, float], light_radius_mm: float
) -> Float32Array:
    """Walk from every cell towards the light, keeping the least angle by which its ray clears the skin."""
    rows, columns = height.shape
    row, column = np.mgrid[:rows, :columns].astype(np.float32)
    away_x = np.float32(light_mm[0]) - (column - (columns - 1) / 2) * np.float32(cell_mm)
    away_y = np.float32(light_mm[1]) - (row - (rows - 1) / 2) * np.float32(cell_mm)
    across = np.hypot(away_x, away_y)
    rise = (np.float32(light_mm[2]) - height) / across
    step_column, step_row = away_x / across, away_y / across
    clearance = np.full_like(height, np.inf)
    reach_cells = float(np.ptp(height)) / float(rise.min()) / cell_mm + 2.0
    # The nearest cells are left to the cosine law: at that distance the grid's own steps would cast shadows.
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
