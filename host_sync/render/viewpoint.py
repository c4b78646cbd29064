"""Viewpoint of a relief, and projection of its points to the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float32Array, HeightMap

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
    """The points of a height map on a picture `columns` wide that fits it; NaN where invalid.

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
    """Coordinates of each point right of, above and behind the map's centre, as seen, µm."""
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
