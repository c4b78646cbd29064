"""The picture of fine detail: diffuse shading with its slopes exaggerated, for it is often only micrometres high."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from device.surface import HeightMap, surface_slopes
from host_sync.render.shading import reduced, shade

WIDEST_PX: Final = 1600
SHOWN_SLOPE: Final = 0.25
"""Root mean square slope that shading shows well."""


def exaggeration(height: HeightMap) -> float:
    """By what factor heights are multiplied so that shading shows them well; 1 where they are steep enough."""
    p, q = surface_slopes(height)
    square = p**2 + q**2
    if not np.isfinite(square).any():
        return 1.0
    return max(1.0, SHOWN_SLOPE / max(float(np.sqrt(np.nanmean(square))), 1e-9))


def write_detail(path: Path, height: HeightMap, title: str) -> None:
    """Write the shaded detail as a PNG, in millimetres on the skin; invalid pixels are white."""
    small = reduced(height, WIDEST_PX)
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
