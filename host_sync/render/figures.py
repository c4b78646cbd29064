"""Reliefs, details and the pictures of a demo in matplotlib figures, and figures as PNG.

matplotlib takes a while to load: it is imported where a figure is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, HeightMap, surface_slopes
from host_sync.render.relief_sheet import MAX_COLUMNS
from host_sync.render.shading import (
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
