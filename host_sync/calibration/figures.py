"""Pictures of the paper's model: reflectance maps with isophotes (its Fig. 3) and an ambiguous bin (its Fig. 4)."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.calibration.paper_model import PaperModel
from host_sync.calibration.reflectance_map import ReflectanceMaps
from host_sync.calibration.reflectance_surface import EXTENSION
from host_sync.calibration.spherical_harmonics import HarmonicFit

CHANNELS: Final = (("red", "#c8102e"), ("green", "#1a7f37"), ("blue", "#0b57d0"))
ISOPHOTES: Final = 13
STAR: Final = {"marker": "*", "s": 190, "color": "#d81b1b", "edgecolor": "white", "linewidth": 0.9, "zorder": 5}


def reflectance_figure(model: PaperModel) -> Figure:
    """Reflectance by slope: rows data, order 2, order 5; a column a channel; isophotes at the same intensities."""
    maps = model.maps
    rows = (
        ("data", _smoothed(maps), None),
        (f"order {model.lambertian.order}, Lambertian", _modelled(maps, model.lambertian), model.residual_order_2),
        (f"order {model.harmonics.order}", _modelled(maps, model.harmonics), model.residual_order_5),
    )
    levels = _levels(rows[0][1])
    figure = Figure(figsize=(9.6, 9.9), layout="constrained")
    grid = figure.subplots(3, 3, sharex=True, sharey=True)
    for line, (title, values, residual) in zip(grid, rows, strict=True):
        for channel, axes in enumerate(line):
            name, colour = CHANNELS[channel]
            filled = _draw_map(axes, maps, values[..., channel], levels, colour)
            axes.set_title(name if residual is None else f"{name}, residual {residual[channel]:.4f}", fontsize=10)
        line[0].set_ylabel(f"{title}\nq = dz/drow, µm/µm")
    for axes in grid[-1]:
        axes.set_xlabel("p = dz/dcolumn, µm/µm")
    bar = figure.colorbar(filled, ax=grid, shrink=0.5, aspect=30, ticks=levels[::2], format="%.2f")
    bar.set_label("intensity (untouched skin reads 1)")
    figure.suptitle("Reflectance by slope, isophotes at the same intensities in every plot", fontsize=12)
    return figure


def ambiguity_figure(model: PaperModel) -> Figure:
    """Density of the balls' colours in (a*, b*) with one ambiguous bin, beside the slopes that make its colour."""
    figure = Figure(figsize=(10.4, 5.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    chosen = _most_ambiguous(model)
    _draw_density(left, model.maps)
    _draw_slopes(right, model)
    if chosen is not None:
        candidates = model.table.candidates[chosen]
        colour = candidates[:, 2:5].mean(axis=0)
        _, a, b = _lab(colour[None], _white(model.maps))[0]
        left.scatter(a, b, **STAR)
        right.scatter(
            candidates[:, 0], candidates[:, 1], label="one bin: its colour, and the slopes that make it", **STAR
        )
        figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    share = model.table.ambiguous_share
    count = round(share * model.table.filled_bins)
    figure.suptitle(f"{count} of {model.table.filled_bins} filled bins are ambiguous ({share:.2%})", fontsize=12)
    return figure


def _draw_map(axes: Axes, maps: ReflectanceMaps, values: Float64Array, levels: Float64Array, colour: str) -> Any:
    shown = np.ma.masked_invalid(values)
    filled = axes.contourf(maps.centres, maps.centres, shown, levels=levels, cmap="gray", extend="both")
    axes.contour(maps.centres, maps.centres, shown, levels=levels, colors=colour, linewidths=0.9)
    _frame(axes, maps.reach)
    return filled


def _frame(axes: Axes, reach: float) -> None:
    axes.set_aspect("equal")
    axes.set_xlim(-reach, reach)
    axes.set_ylim(reach, -reach)
    axes.tick_params(labelsize=8)


def _levels(values: Float64Array) -> Float64Array:
    low, high = np.nanpercentile(values, [1.0, 99.0])
    return np.linspace(low, max(high, low + 1e-3), ISOPHOTES)


def _smoothed(maps: ReflectanceMaps, sigma_cells: float = 0.8) -> Float64Array:
    """Observed maps averaged over neighbouring cells, NaN where nothing was observed near."""
    seen = maps.observed
    count = gaussian_filter(maps.count.astype(np.float64), sigma_cells)
    sums = np.where(seen[..., None], maps.mean * maps.count[..., None], 0.0)
    near = gaussian_filter(seen.astype(np.float64), sigma_cells) > 0.25
    mean = gaussian_filter(sums, (sigma_cells, sigma_cells, 0.0)) / np.maximum(count, 1e-9)[..., None]
    return np.where((near & (count > 1e-9))[..., None], mean, np.nan)


def _disc(maps: ReflectanceMaps) -> MaskArray:
    p, q = np.meshgrid(maps.centres, maps.centres)
    return np.asarray(p * p + q * q <= maps.reach**2)


def _modelled(maps: ReflectanceMaps, fit: HarmonicFit) -> Float64Array:
    p, q = np.meshgrid(maps.centres, maps.centres)
    values = fit.reflectance(p.ravel(), q.ravel()).reshape(*p.shape, 3)
    return np.where(_disc(maps)[..., None], values, np.nan)


def _most_ambiguous(model: PaperModel) -> slice | None:
    """Candidates of the bin with the most of them, and of those the one whose slopes lie farthest apart."""
    first = model.table.first
    count = np.diff(first)
    if count.max() < 2:
        return None
    slopes = model.table.candidates[:, :2]
    bins = np.flatnonzero(count == count.max())
    apart = [float(np.ptp(slopes[first[i] : first[i + 1]], axis=0).sum()) for i in bins]
    chosen = bins[int(np.argmax(apart))]
    return slice(int(first[chosen]), int(first[chosen + 1]))


def _white(maps: ReflectanceMaps) -> float:
    """The intensity shown as white."""
    return float(np.nanpercentile(maps.mean, 99.5))


def _lab(intensity: NDArray[np.floating], white: float) -> Float32Array:
    """L*, a*, b* of shape (N, 3) of intensities (N, 3) shown as linear sRGB."""
    linear = np.clip(intensity / white, 0.0, 1.0).astype(np.float32)
    return np.asarray(cv2.cvtColor(_encoded(linear)[None], cv2.COLOR_RGB2LAB)[0], np.float32)


def _encoded(linear: Float32Array) -> Float32Array:
    """Linear light encoded as sRGB."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055).astype(np.float32)


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
    """Slope space in the colours that slopes make, with the slopes of all ambiguous bins as dots."""
    reach = (1.0 + EXTENSION) * model.maps.reach
    p, q = np.meshgrid(*[np.linspace(-reach, reach, 201)] * 2)
    values = model.harmonics.reflectance(p.ravel(), q.ravel()).reshape(*p.shape, 3)
    linear = np.clip(values / _white(model.maps), 0.0, 1.0).astype(np.float32)
    picture = np.where((p * p + q * q <= reach**2)[..., None], _encoded(linear), 1.0)
    axes.imshow(picture, extent=(-reach, reach, reach, -reach), interpolation="bilinear")
    table = model.table
    doubtful = np.repeat(np.diff(table.first) > 1, np.diff(table.first))
    if doubtful.any():
        p, q = table.candidates[doubtful, 0], table.candidates[doubtful, 1]
        axes.plot(p, q, ".", color="black", markersize=2.0, alpha=0.6, label="slopes of all ambiguous bins")
    _frame(axes, reach)
    axes.set_title("slopes, in the colours that they make")
    axes.set_xlabel("p = dz/dcolumn, µm/µm")
    axes.set_ylabel("q = dz/drow, µm/µm")
