"""Colours that several slopes make: one bin with its clusters, and how many bins are like it (paper, Fig. 4)."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from device.surface import Float32Array, Float64Array
from host_sync.calibration.lookup_table import slopes_of_bin
from host_sync.calibration.mean_shift import MOST_CLUSTERS
from host_sync.calibration.paper_model import PaperModel
from host_sync.calibration.reflectance_map import ReflectanceMaps
from host_sync.calibration.reflectance_surface import EXTENSION, ReflectanceSurface, reflectance_surface
from host_sync.calibration.slope_axes import P_LABEL, Q_LABEL, caption, frame_slopes

_CAPTION: Final = (
    "Left: isodensity contours of the colours of the calibration's balls; the star is the colour of the bin with the "
    "most candidates. Middle: slopes, in grey how bright the mean of the three colours is; the small dots are the "
    "slopes that fall into that bin, the stars the centres that mean shift finds among them, and the grey crosses the "
    "centres of all ambiguous bins. Right: how many slopes the filled bins offer."
)


def ambiguity_figure(model: PaperModel) -> Figure:
    """Density of the balls' colours in (a*, b*), the slopes of the most ambiguous bin, and candidates a bin."""
    figure = Figure(figsize=(15.5, 5.9), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 0.7))
    _draw_density(left, model.maps)
    _draw_slopes(middle, model)
    chosen = most_ambiguous(model)
    if chosen is not None:
        _draw_bin(left, middle, model, chosen)
    if middle.get_legend_handles_labels()[0]:
        middle.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, fontsize=8, frameon=False)
    _draw_counts(right, model)
    share = model.table.ambiguous_share
    count = round(share * model.table.filled_bins)
    figure.suptitle(f"{count} of {model.table.filled_bins} filled bins are ambiguous ({share:.2%})", fontsize=13)
    caption(figure, _CAPTION)
    return figure


def most_ambiguous(model: PaperModel) -> int | None:
    """The filled bin with the most candidates, and of those the one whose slopes lie farthest apart."""
    first = model.table.first
    count = np.diff(first)
    if count.max() < 2:
        return None
    slopes = model.table.candidates[:, :2]
    bins = np.flatnonzero(count == count.max())
    apart = [float(np.ptp(slopes[first[i] : first[i + 1]], axis=0).sum()) for i in bins]
    return int(bins[int(np.argmax(apart))])


def _draw_bin(left: Axes, middle: Axes, model: PaperModel, chosen: int) -> None:
    table = model.table
    candidates = table.candidates[table.first[chosen] : table.first[chosen + 1]]
    colour = candidates[:, 2:5].mean(axis=0)
    _, a, b = _lab(colour[None], _white(model.maps))[0]
    _draw_stars(left, np.array([[a, b]]), None)
    members = slopes_of_bin(reflectance_surface(model.maps, model.harmonics), table, chosen)
    middle.plot(members[:, 0], members[:, 1], ".", color="#0072b2", ms=4.0, zorder=6, label="slopes of one bin")
    _draw_stars(middle, candidates[:, :2], "centres of its clusters")


def _draw_stars(axes: Axes, points: NDArray[np.floating], label: str | None) -> None:
    axes.plot(points[:, 0], points[:, 1], "*", color="#d55e00", ms=15.0, mec="white", mew=1.0, zorder=5, label=label)


def _draw_density(axes: Axes, maps: ReflectanceMaps) -> None:
    """Isodensity contours of the balls' colours in (a*, b*)."""
    seen = maps.observed
    lab = _lab(maps.mean[seen], _white(maps))
    reach = 1.15 * max(float(np.abs(lab[:, 1:]).max()), 1.0)
    edges = np.linspace(-reach, reach, 81)
    density, _, _ = np.histogram2d(lab[:, 2], lab[:, 1], bins=(edges, edges), weights=maps.count[seen])
    density = gaussian_filter(density, 1.5)
    middle = 0.5 * (edges[1:] + edges[:-1])
    levels = density.max() * np.geomspace(0.01, 0.9, 9)
    axes.contourf(middle, middle, density, levels=levels, cmap="Greys", extend="max", alpha=0.55)
    axes.contour(middle, middle, density, levels=levels, colors="#444444", linewidths=0.7)
    axes.set_aspect("equal")
    axes.set_title("density of the balls' colours")
    axes.set_xlabel("a* (green to red)")
    axes.set_ylabel("b* (blue to yellow)")


def _draw_slopes(axes: Axes, model: PaperModel) -> None:
    """Slope space in shades of how bright it is, with the centres of all ambiguous bins."""
    surface = reflectance_surface(model.maps, model.harmonics)
    reach = (1.0 + EXTENSION) * model.maps.reach
    shown = _brightness(surface, np.linspace(-reach, reach, 201))
    axes.imshow(
        shown, extent=(-reach, reach, reach, -reach), cmap="gray", vmin=-0.4, vmax=1.3, interpolation="bilinear"
    )
    table = model.table
    doubtful = np.repeat(np.diff(table.first) > 1, np.diff(table.first))
    if doubtful.any():
        p, q = table.candidates[doubtful, 0], table.candidates[doubtful, 1]
        axes.plot(p, q, "x", color="#222222", ms=2.5, mew=0.5, alpha=0.5, label="centres of all ambiguous bins")
    frame_slopes(axes, reach)
    axes.set_title("slopes")
    axes.set_xlabel(P_LABEL)
    axes.set_ylabel(Q_LABEL)


def _brightness(surface: ReflectanceSurface, slopes: Float64Array) -> Float64Array:
    """Mean of the channels on a square grid of slopes, 0 to 1; NaN beyond the surface's reach."""
    p, q = np.meshgrid(slopes, slopes)
    mean = surface.on_grid(slopes).mean(axis=-1)
    inside = p * p + q * q <= surface.reach**2
    low, high = np.percentile(mean[inside], [1.0, 99.0])
    return np.where(inside, np.clip((mean - low) / max(high - low, 1e-9), 0.0, 1.0), np.nan)


def _draw_counts(axes: Axes, model: PaperModel) -> None:
    """Share of the filled bins by their number of candidates, on a logarithmic scale."""
    count = np.diff(model.table.first)
    number = np.arange(1, max(int(count.max()), MOST_CLUSTERS) + 1)
    share = np.array([(count == n).mean() for n in number])
    bars = axes.bar(number, share, color="#56b4e9", edgecolor="black", linewidth=0.6)
    axes.bar_label(bars, [f"{100.0 * s:.2f} %" for s in share], fontsize=9)
    axes.set_yscale("log")
    axes.set_ylim(0.2 / len(count), 3.0)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100.0 * share:g} %"))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_title("candidates a bin")
    axes.set_xlabel("slopes that make the bin's colour")
    axes.set_ylabel("share of the filled bins")


def _white(maps: ReflectanceMaps) -> float:
    """The intensity shown as white."""
    return float(np.nanpercentile(maps.mean, 99.5))


def _lab(intensity: NDArray[np.floating], white: float) -> Float32Array:
    """L*, a*, b* of shape (N, 3) of intensities (N, 3) shown as linear sRGB."""
    linear = np.clip(intensity / white, 0.0, 1.0).astype(np.float32)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055).astype(np.float32)
    return np.asarray(cv2.cvtColor(encoded[None], cv2.COLOR_RGB2LAB)[0], np.float32)
