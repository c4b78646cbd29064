"""Reliefs and details in matplotlib figures."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from device.surface.fields import HeightMap, surface_slopes
from host_sync.render.colormap import tint_table
from host_sync.render.relief import height_range_um, relief_rgb
from host_sync.render.relief_sheet import MAX_COLUMNS
from host_sync.render.shading import exaggeration_for, reduced, shade, steep_slope


def draw_relief(axes: Axes, height: HeightMap, title: str) -> None:
    """Draw the relief in `axes`, in millimetres on the skin, with its height scale beside it."""
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
    """Factor on the heights that gives good contrast; at least 1. Detail is often only micrometres high."""
    p, q = surface_slopes(height)
    square = p**2 + q**2
    if not np.isfinite(square).any():
        return 1.0
    return max(1.0, SHOWN_SLOPE / max(float(np.sqrt(np.nanmean(square))), 1e-9))


def write_detail(path: Path, height: HeightMap, title: str) -> None:
    """Write the shaded detail as a PNG, in millimetres on the skin; invalid pixels are white."""
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
