"""The paper's figures of a calibration: reflectance maps (Fig. 3) and ambiguous bins (Fig. 4)."""

from __future__ import annotations

from textwrap import fill
from typing import Any, Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from device.surface import Float32Array, Float64Array
from host_sync.johnson2009.lookup_table import MAX_CLUSTERS, slopes_of_bin
from host_sync.johnson2009.model import PaperModel
from host_sync.johnson2009.spherical_harmonics import (
    EXTENSION,
    HarmonicFit,
    ReflectanceMaps,
    ReflectanceSurface,
    reflectance_surface,
)

CHANNELS: Final = ("red", "green", "blue")
ISOPHOTES: Final = 11
RESIDUAL_STEPS: Final = 9
RESIDUAL_CELLS: Final = 2.0
"""Standard deviation of the Gaussian over drawn residuals, cells: model errors are broader, pixel noise is not."""

_REFLECTANCE_CAPTION: Final = (
    "Rows: colour channels. Columns: observed intensity of the calibration's balls on a fixed grid of slopes; the "
    "Lambertian approximation (spherical harmonics of orders 0 to 2); orders 0 to 5; and the residuals of both. "
    "Isophotes are at the same intensities in every plot of a channel; they are dense where the skin shines. In the "
    "residuals dashed lines are negative; pixel noise is smoothed out for drawing, rms is that of all observed cells."
)


def reflectance_figure(model: PaperModel) -> Figure:
    """Return one row per channel: data, order 2, order 5, and the residuals of both."""
    maps = model.maps
    observed = _smoothed(maps)
    fits = (model.lambertian, model.harmonics)
    modelled = [_modelled(maps, fit) for fit in fits]
    broad = _smoothed(maps, RESIDUAL_CELLS)
    left = [broad - values for values in modelled]
    limit = max(float(np.nanpercentile(np.abs(left[0]), 99.0)), 1e-4)
    figure = Figure(figsize=(15.5, 10.2), layout="constrained")
    grid = figure.subplots(3, 5, sharex=True, sharey=True)
    for channel, line in enumerate(grid):
        levels = _levels(observed[..., channel])
        for axes, values in zip(line[:3], (observed, *modelled), strict=True):
            filled = _draw_map(axes, maps, values[..., channel], levels)
        figure.colorbar(filled, ax=line[:3], shrink=0.8, aspect=24, ticks=levels[::2], format="%.2f", label="intensity")
        for axes, values, fit in zip(line[3:], left, fits, strict=True):
            spread = _draw_residual(axes, maps, values[..., channel], limit)
            axes.set_title(f"rms {fit.residual[channel]:.4f}", fontsize=9)
        line[0].set_ylabel(f"{CHANNELS[channel]}\n{Q_LABEL}")
    figure.colorbar(
        spread, ax=grid[:, 3:], shrink=0.5, aspect=36, format="%.3f", label="observed minus modelled intensity"
    )
    names = ("observed", *(f"order {fit.order}" for fit in fits), *(f"residual of order {fit.order}" for fit in fits))
    for axes, name in zip(grid[0], names, strict=True):
        axes.set_title(f"{name}\n{axes.get_title()}".strip(), fontsize=11)
    for axes in grid[-1]:
        axes.set_xlabel(P_LABEL)
    figure.suptitle("Reflectance by slope (untouched skin reads 1)", fontsize=13)
    caption(figure, _REFLECTANCE_CAPTION)
    return figure


def _draw_map(axes: Axes, maps: ReflectanceMaps, values: Float64Array, levels: Float64Array) -> Any:
    shown = np.ma.masked_invalid(values)
    filled = axes.contourf(maps.centres, maps.centres, shown, levels=levels, cmap="gray", extend="both")
    axes.contour(maps.centres, maps.centres, shown, levels=levels, colors="#d08a00", linewidths=0.9)
    frame_slopes(axes, maps.reach)
    return filled


def _draw_residual(axes: Axes, maps: ReflectanceMaps, values: Float64Array, limit: float) -> Any:
    """Violet below and orange above zero; dashed and solid lines show the same without colour."""
    shown = np.ma.masked_invalid(values)
    levels = np.linspace(-limit, limit, RESIDUAL_STEPS + 1)
    filled = axes.contourf(maps.centres, maps.centres, shown, levels=levels, cmap="PuOr_r", extend="both")
    axes.contour(maps.centres, maps.centres, shown, levels=levels, colors="black", linewidths=0.5)
    frame_slopes(axes, maps.reach)
    return filled


def _levels(values: Float64Array) -> Float64Array:
    low, high = np.nanpercentile(values, [1.0, 99.0])
    return np.linspace(low, max(high, low + 1e-3), ISOPHOTES)


def _smoothed(maps: ReflectanceMaps, sigma_cells: float = 0.8) -> Float64Array:
    """Return the observed maps averaged over neighbouring cells, NaN where nothing was observed nearby."""
    seen = maps.observed
    count = gaussian_filter(maps.count.astype(np.float64), sigma_cells)
    sums = np.where(seen[..., None], maps.mean * maps.count[..., None], 0.0)
    around = gaussian_filter(seen.astype(np.float64), sigma_cells)
    near = around > min(0.25, 0.5 * around.max())
    mean = gaussian_filter(sums, (sigma_cells, sigma_cells, 0.0)) / np.maximum(count, 1e-9)[..., None]
    return np.where((near & (count > 1e-9))[..., None], mean, np.nan)


def _modelled(maps: ReflectanceMaps, fit: HarmonicFit) -> Float64Array:
    """Modelled maps, float64 array of shape (CELLS, CELLS, 3), NaN beyond the steepest observed slope."""
    p, q = np.meshgrid(maps.centres, maps.centres)
    values = fit.reflectance(p.ravel(), q.ravel()).reshape(*p.shape, 3)
    return np.where((p * p + q * q <= maps.reach**2)[..., None], values, np.nan)


P_LABEL: Final = "p = dz/dcolumn, µm/µm"
Q_LABEL: Final = "q = dz/drow, µm/µm"

_CHARACTERS_PER_INCH: Final = 15.0


def frame_slopes(axes: Axes, reach: float) -> None:
    """Show slopes from -reach to reach in both directions, oriented as in a frame: q grows downwards."""
    axes.set_aspect("equal")
    axes.set_xlim(-reach, reach)
    axes.set_ylim(reach, -reach)
    axes.tick_params(labelsize=8)


def caption(figure: Figure, words: str) -> None:
    """Write a caption under the figure, wrapped to its width."""
    width = int(_CHARACTERS_PER_INCH * figure.get_size_inches()[0])
    figure.supxlabel(fill(words, width), fontsize=9, x=0.01, ha="left", multialignment="left")


_AMBIGUITY_CAPTION: Final = (
    "Left: density contours of the colours of the calibration's balls; the star is the colour of the bin with the "
    "most candidates. Middle: slopes, with the mean brightness of the three colours in grey; dots are the slopes "
    "that fall into that bin, stars their centres by mean shift, grey crosses the centres of all ambiguous bins. "
    "Right: number of candidate slopes of the filled bins."
)


def ambiguity_figure(model: PaperModel) -> Figure:
    """Return the figure of the balls' colours, the most ambiguous bin, and the candidates per bin.

    It shows the density of the colours in (a*, b*), and the slopes of the bin.
    """
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
    fraction = model.table.ambiguous_fraction
    count = round(fraction * model.table.filled_bins)
    figure.suptitle(f"{count} of {model.table.filled_bins} filled bins are ambiguous ({fraction:.2%})", fontsize=13)
    caption(figure, _AMBIGUITY_CAPTION)
    return figure


def most_ambiguous(model: PaperModel) -> int | None:
    """Filled bin with the most candidates; among several, the one whose slopes are farthest apart."""
    first = model.table.first
    count = np.diff(first)
    if count.max() < 2:
        return None
    slopes = model.table.candidates[:, :2]
    bins = np.flatnonzero(count == count.max())
    spread = [float(np.ptp(slopes[first[i] : first[i + 1]], axis=0).sum()) for i in bins]
    return int(bins[int(np.argmax(spread))])


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
    """Density contours of the balls' colours in (a*, b*)."""
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
    """Slope space in grey by brightness, with the centres of all ambiguous bins."""
    surface = reflectance_surface(model.maps, model.harmonics)
    reach = (1.0 + EXTENSION) * model.maps.reach
    shown = _brightness(surface, np.linspace(-reach, reach, 201))
    axes.imshow(
        shown, extent=(-reach, reach, reach, -reach), cmap="gray", vmin=-0.4, vmax=1.3, interpolation="bilinear"
    )
    table = model.table
    ambiguous = np.repeat(np.diff(table.first) > 1, np.diff(table.first))
    if ambiguous.any():
        p, q = table.candidates[ambiguous, 0], table.candidates[ambiguous, 1]
        axes.plot(p, q, "x", color="#222222", ms=2.5, mew=0.5, alpha=0.5, label="centres of all ambiguous bins")
    frame_slopes(axes, reach)
    axes.set_title("slopes")
    axes.set_xlabel(P_LABEL)
    axes.set_ylabel(Q_LABEL)


def _brightness(surface: ReflectanceSurface, slopes: Float64Array) -> Float64Array:
    """Return the mean of the channels on a square grid of slopes, 0 to 1; NaN beyond the surface's reach."""
    p, q = np.meshgrid(slopes, slopes)
    mean = surface.on_grid(slopes).mean(axis=-1)
    inside = p * p + q * q <= surface.reach**2
    low, high = np.percentile(mean[inside], [1.0, 99.0])
    return np.where(inside, np.clip((mean - low) / max(high - low, 1e-9), 0.0, 1.0), np.nan)


def _draw_counts(axes: Axes, model: PaperModel) -> None:
    """Fraction of the filled bins by their number of candidates, on a logarithmic scale."""
    count = np.diff(model.table.first)
    number = np.arange(1, max(int(count.max()), MAX_CLUSTERS) + 1)
    fraction = np.array([(count == n).mean() for n in number])
    bars = axes.bar(number, fraction, color="#56b4e9", edgecolor="black", linewidth=0.6)
    axes.bar_label(bars, [f"{100.0 * f:.2f} %" for f in fraction], fontsize=9)
    axes.set_yscale("log")
    axes.set_ylim(0.2 / len(count), 3.0)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100.0 * value:g} %"))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_title("candidates per bin")
    axes.set_xlabel("slopes that produce the bin's colour")
    axes.set_ylabel("fraction of the filled bins")


def _white(maps: ReflectanceMaps) -> float:
    """Return the intensity shown as white."""
    return float(np.nanpercentile(maps.mean, 99.5))


def _lab(intensity: NDArray[np.floating], white: float) -> Float32Array:
    """L*, a*, b* of shape (N, 3) of intensities (N, 3) shown as linear sRGB."""
    linear = np.clip(intensity / white, 0.0, 1.0).astype(np.float32)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055).astype(np.float32)
    return np.asarray(cv2.cvtColor(encoded[None], cv2.COLOR_RGB2LAB)[0], np.float32)


def paper_figures(model: PaperModel) -> dict[str, Figure]:
    """Return figures like the paper's 3 and 4, by file name."""
    return {"reflectance-maps": reflectance_figure(model), "ambiguous-bins": ambiguity_figure(model)}
