"""A ball's errors with level curves at 2 % and 4 % of its radius and at 2° and 4° (paper, Fig. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from device.surface import Float32Array
from host_sync.calibration.slope_axes import caption
from host_sync.reconstruction.held_out_ball import BallError

LEVELS: Final = (2.0, 4.0)
SCALE_END: Final = 6.0
CURVE_BLUR_SHARE: Final = 0.015
"""Standard deviation of the Gaussian over what the curves are drawn from, as a share of the window."""

METHOD_NAMES: Final = {"direct": "default: direct inverse map", "paper": "paper's method"}

_CAPTION: Final = (
    "A ball that was kept out of the calibration, by each method. Upper row: height error in percent of the ball's "
    "radius, its median taken off because the ball's own height above the skin is not known. Lower row: error of the "
    "surface's normal. Light is right, dark is wrong; the black curve stands at 2, the white one at 4. Dotted: the "
    "contact's inner 90 %, over which the means are taken. Curves are drawn from errors without pixel noise, figures "
    "stated from all of it."
)


def ball_error_figure(errors: Sequence[BallError]) -> Figure:
    """A column a method; above the height error, below the angular error."""
    figure = Figure(figsize=(4.6 * len(errors) + 1.6, 9.9), layout="constrained")
    grid = figure.subplots(2, len(errors), squeeze=False, sharex=True, sharey=True)
    for column, error in enumerate(errors):
        upper, lower = grid[0][column], grid[1][column]
        percent = _draw(upper, error, error.height_percent)
        upper.set_title(f"{METHOD_NAMES[error.method]}\n{_height_words(error)}", fontsize=10)
        degrees = _draw(lower, error, error.angle_deg)
        lower.set_title(_angle_words(error), fontsize=10)
        lower.set_xlabel("column, mm")
    for line, shown, label in (
        (grid[0], percent, "height error, % of radius"),
        (grid[1], degrees, "error of normal, °"),
    ):
        line[0].set_ylabel("row, mm")
        figure.colorbar(shown, ax=line, shrink=0.85, extend="max", label=label)
    first = errors[0]
    figure.suptitle(f"Ball of radius {first.radius_um / 1e3:.4g} mm in {_short(first.press)}", fontsize=12)
    caption(figure, _CAPTION)
    return figure


def _draw(axes: Axes, error: BallError, values: Float32Array) -> Any:
    """Errors inside the contact in the colours of their size, with the level curves."""
    mm = error.height.pitch_um / 1e3
    rows, columns = values.shape
    shown = np.where(error.inside, values, np.nan)
    image = axes.imshow(
        shown,
        cmap="cividis_r",
        vmin=0.0,
        vmax=SCALE_END,
        extent=(0.0, columns * mm, rows * mm, 0.0),
        interpolation="nearest",
    )
    x, y = (np.arange(columns) + 0.5) * mm, (np.arange(rows) + 0.5) * mm
    smooth = np.ma.masked_where(~error.inner, _smoothed(error, values))
    for level, colour in zip(LEVELS, ("black", "white"), strict=True):
        if smooth.max() > level > smooth.min():
            axes.contour(x, y, smooth, levels=[level], colors=[colour], linewidths=1.4)
    axes.contour(x, y, error.inner.astype(np.float32), levels=[0.5], colors=["dimgray"], linewidths=1.0, linestyles=":")
    return image


def _smoothed(error: BallError, values: Float32Array) -> Float32Array:
    """Gaussian mean over the contact, so that curves show the shape of the error and not its noise."""
    sigma_px = max(CURVE_BLUR_SHARE * max(values.shape), 0.8)
    weight = cv2.GaussianBlur(error.inside.astype(np.float32), (0, 0), sigma_px)
    total = cv2.GaussianBlur(np.where(error.inside, values, np.float32(0.0)), (0, 0), sigma_px)
    return np.asarray(total / np.maximum(weight, 1e-6), np.float32)


def _height_words(error: BallError) -> str:
    off_um, percent = np.abs(error.height_um[error.inner]), error.height_percent[error.inner]
    return f"height: mean {off_um.mean():.2g} µm ({percent.mean():.2f} % of R)\n{_shares(percent, ' %')}"


def _angle_words(error: BallError) -> str:
    angle = error.angle_deg[error.inner]
    return f"normal: mean {angle.mean():.2f}°, median {np.median(angle):.2f}°\n{_shares(angle, '°')}"


def _shares(values: Float32Array, unit: str) -> str:
    within = [f"{(values <= level).mean() * 100.0:.0f} % within {level:g}{unit}" for level in LEVELS]
    return ", ".join(within)


def _short(press: str) -> str:
    """A press's name without the folders of its file."""
    return f"{press.split(' (')[0]} ({Path(press.split(' (')[1].rstrip(')')).name})" if " (" in press else press
