"""The relief picture of a height map: diffuse shading, tinted by height, with a scale in µm."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from device.surface import HeightMap
from host_sync.render.shading import reduced, shade

WIDEST_PX: Final = 1600
TINT: Final = "cividis"
"""Readable without colour vision, and dark to light as low to high."""


def relief_rgb(height: HeightMap, low_um: float, high_um: float) -> NDArray[np.float32]:
    """Picture of shape (H, W, 3), 0 to 1: shading times the tint of the height; invalid pixels are white."""
    share = (height.z_um - low_um) / max(high_um - low_um, 1e-9)
    tint: NDArray[Any] = colormaps[TINT](0.25 + 0.75 * np.clip(share, 0.0, 1.0))[..., :3]
    rgb = tint * (0.35 + 0.9 * shade(height))[..., None]
    return np.asarray(np.where(np.isfinite(rgb), np.clip(rgb, 0.0, 1.0), 1.0), np.float32)


def height_range_um(height: HeightMap) -> tuple[float, float]:
    """Heights (µm) between which nearly all valid pixels lie; (0, 1) when none is valid."""
    finite = height.z_um[np.isfinite(height.z_um)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, [0.1, 99.9])
    return float(low), float(max(high, low + 1e-3))


def draw_relief(axes: Axes, height: HeightMap, title: str) -> None:
    """The relief in `axes`, in millimetres on the skin, with its height scale beside it."""
    small = reduced(height, WIDEST_PX)
    low_um, high_um = height_range_um(small)
    rows, columns = small.z_um.shape
    mm = small.pitch_um / 1000.0
    axes.imshow(relief_rgb(small, low_um, high_um), extent=(0.0, columns * mm, rows * mm, 0.0), interpolation="nearest")
    axes.set_title(title)
    axes.set_xlabel("column, mm")
    axes.set_ylabel("row, mm")
    figure = axes.get_figure()
    if isinstance(figure, Figure):
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        scale = ScalarMappable(Normalize(low_um, high_um), colormaps[TINT])
        figure.colorbar(scale, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), label="height, µm")


def write_relief(path: Path, height: HeightMap, title: str) -> None:
    """Write the relief as a PNG."""
    rows, columns = height.z_um.shape
    figure = Figure(figsize=(10.0, 10.0 * rows / columns + 0.6), layout="constrained")
    draw_relief(figure.add_subplot(), height, title)
    figure.savefig(path, dpi=150)
