"""Reflectance by slope, observed and modelled, with what each model leaves (paper, Fig. 3)."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from device.surface import Float64Array
from host_sync.calibration.paper_model import PaperModel
from host_sync.calibration.reflectance_map import ReflectanceMaps
from host_sync.calibration.slope_axes import P_LABEL, Q_LABEL, caption, frame_slopes
from host_sync.calibration.spherical_harmonics import HarmonicFit

CHANNELS: Final = ("red", "green", "blue")
ISOPHOTES: Final = 11
RESIDUAL_STEPS: Final = 9
RESIDUAL_CELLS: Final = 2.0
"""Standard deviation of the Gaussian over drawn residuals, cells: what a model lacks is broader, pixel noise is not."""

_CAPTION: Final = (
    "Rows: colour channels. Columns: intensity that the calibration's balls showed on a fixed grid of slopes; the "
    "Lambertian approximation (spherical harmonics of orders 0 to 2); the first six orders (0 to 5); and what each of "
    "them leaves. Isophotes stand at the same intensities in every plot of a channel; where they crowd, the skin "
    "shines. In the residuals dashed lines are negative; they are drawn without pixel noise, rms is that of all "
    "observed cells."
)


def reflectance_figure(model: PaperModel) -> Figure:
    """A row a channel: data, order 2, order 5, and the residuals of both side by side."""
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
        spread, ax=grid[:, 3:], shrink=0.5, aspect=36, format="%.3f", label="observed less modelled intensity"
    )
    names = ("observed", *(f"order {fit.order}" for fit in fits), *(f"residual of order {fit.order}" for fit in fits))
    for axes, name in zip(grid[0], names, strict=True):
        axes.set_title(f"{name}\n{axes.get_title()}".strip(), fontsize=11)
    for axes in grid[-1]:
        axes.set_xlabel(P_LABEL)
    figure.suptitle("Reflectance by slope (untouched skin reads 1)", fontsize=13)
    caption(figure, _CAPTION)
    return figure


def _draw_map(axes: Axes, maps: ReflectanceMaps, values: Float64Array, levels: Float64Array) -> Any:
    shown = np.ma.masked_invalid(values)
    filled = axes.contourf(maps.centres, maps.centres, shown, levels=levels, cmap="gray", extend="both")
    axes.contour(maps.centres, maps.centres, shown, levels=levels, colors="#d08a00", linewidths=0.9)
    frame_slopes(axes, maps.reach)
    return filled


def _draw_residual(axes: Axes, maps: ReflectanceMaps, values: Float64Array, limit: float) -> Any:
    """Violet below and orange above zero; dashed and solid lines say the same without colour."""
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
    """Observed maps averaged over neighbouring cells, NaN where nothing was observed near."""
    seen = maps.observed
    count = gaussian_filter(maps.count.astype(np.float64), sigma_cells)
    sums = np.where(seen[..., None], maps.mean * maps.count[..., None], 0.0)
    near = gaussian_filter(seen.astype(np.float64), sigma_cells) > 0.25
    mean = gaussian_filter(sums, (sigma_cells, sigma_cells, 0.0)) / np.maximum(count, 1e-9)[..., None]
    return np.where((near & (count > 1e-9))[..., None], mean, np.nan)


def _modelled(maps: ReflectanceMaps, fit: HarmonicFit) -> Float64Array:
    """Modelled maps, float64 array of shape (CELLS, CELLS, 3), NaN beyond the steepest observed slope."""
    p, q = np.meshgrid(maps.centres, maps.centres)
    values = fit.reflectance(p.ravel(), q.ravel()).reshape(*p.shape, 3)
    return np.where((p * p + q * q <= maps.reach**2)[..., None], values, np.nan)
