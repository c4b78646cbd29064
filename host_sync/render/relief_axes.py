"""The relief inside a matplotlib figure."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from device.surface import HeightMap
from host_sync.render.relief import height_range_um, relief_rgb
from host_sync.render.relief_sheet import WIDEST_PX
from host_sync.render.shading import exaggeration_for, reduced, steep_slope
from host_sync.render.tints import tint_table


def draw_relief(axes: Axes, height: HeightMap, title: str) -> None:
    """The relief in `axes`, in millimetres on the skin, with its height scale beside it."""
    small = reduced(height, WIDEST_PX)
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
