"""Pictures of a calibration's balls: where they were found, which were rejected, how well each was explained."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from device.surface import Float32Array
from host_sync.calibration.ball_location import UsedPress
from host_sync.calibration.full_calibration import Calibration

WIDEST_PX = 1500
MOST_SHOWN = 16
KEPT_COLOUR, REJECTED_COLOUR = "#ffffff", "#ffb000"


def balls_figure(presses: Sequence[UsedPress]) -> Figure:
    """Every press (at most `MOST_SHOWN`, spread over all) with its used and its rejected balls."""
    shown = list(presses[:: -(-len(presses) // MOST_SHOWN)])
    across = int(np.ceil(np.sqrt(len(shown))))
    down = -(-len(shown) // across)
    rows, columns = shown[0].intensity.shape
    figure = Figure(figsize=(12.0, 12.0 / across * rows / columns * down + 0.8), layout="constrained")
    grid = figure.subplots(down, across, squeeze=False).ravel()
    for axes, press in zip(grid, shown, strict=False):
        _draw_press(axes, press, WIDEST_PX // across)
    for axes in grid[len(shown) :]:
        axes.set_axis_off()
    used = sum(len(press.balls) for press in presses)
    rejected = sum(len(press.rejected) for press in presses)
    figure.suptitle(f"{used} balls used (+, circle: trusted contact), {rejected} rejected (x)")
    return figure


def _draw_press(axes: Axes, press: UsedPress, widest_px: int) -> None:
    rows, columns = press.intensity.shape
    axes.imshow(_viewable(press.intensity.values, widest_px), extent=(-0.5, columns - 0.5, rows - 0.5, -0.5))
    for ball in press.balls:
        axes.add_patch(Circle((ball.column, ball.row), ball.contact_radius_px, fill=False, color=KEPT_COLOUR, lw=1.2))
        axes.plot(ball.column, ball.row, "+", color=KEPT_COLOUR, ms=6, mew=1.0)
    for rejected in press.rejected:
        axes.plot(rejected.column, rejected.row, "x", color=REJECTED_COLOUR, ms=8, mew=1.6)
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.set_title(press.name, fontsize=8)
    axes.set_xticks([])
    axes.set_yticks([])


def residuals_figure(calibration: Calibration) -> Figure:
    """Held-out error by slope and by ball."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    by_slope, by_ball = figure.subplots(1, 2)
    _draw_bands(by_slope, calibration)
    errors = calibration.inverse.ball_error_deg
    kept = calibration.inverse.kept
    number = np.arange(len(errors)) + 1
    by_ball.bar(number[kept], errors[kept], color="#4477aa", label="used")
    if not kept.all():
        by_ball.bar(number[~kept], errors[~kept], color="#ddcc77", hatch="//", edgecolor="#776622", label="rejected")
        by_ball.legend(frameon=False)
    by_ball.set_title("held-out error of each ball")
    by_ball.set_xlabel("ball")
    by_ball.set_ylabel("mean error of the normal, degrees")
    return figure


def _draw_bands(axes: Axes, calibration: Calibration) -> None:
    bands = calibration.inverse.bands
    axes.bar(
        [0.5 * (band.from_deg + band.to_deg) for band in bands],
        [band.error_deg for band in bands],
        width=[0.9 * (band.to_deg - band.from_deg) for band in bands],
        color="#4477aa",
    )
    axes.set_title("held-out error by slope")
    axes.set_xlabel("tilt of the surface, degrees")
    axes.set_ylabel("mean error of the normal, degrees")


def _viewable(values: Float32Array, widest_px: int) -> Float32Array:
    """Intensity as a picture: flat skin mid-grey, gently compressed."""
    factor = max(1, values.shape[1] // widest_px)
    if factor > 1:
        size = (values.shape[1] // factor, values.shape[0] // factor)
        values = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
    return np.asarray(np.clip(0.45 * values, 0.0, 1.0) ** 0.8, np.float32)
