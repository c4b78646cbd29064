"""Pictures of a calibration's balls: where they were found, which were rejected, how well each was explained."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.preparation import TrainingPress, pictures_across

MAX_NAMES: Final = 60
KEPT_COLOUR, REJECTED_COLOUR = "#ffffff", "#ffb000"
KEPT_BAR: Final[dict[str, Any]] = {"color": "#4477aa", "label": "used"}
REJECTED_BAR: Final[dict[str, Any]] = {"color": "#ddcc77", "hatch": "//", "edgecolor": "#776622", "label": "rejected"}


def balls_figure(presses: Sequence[TrainingPress]) -> Figure:
    """Return presses with their used and rejected balls: those that have a picture."""
    shown = [press for press in presses if press.picture is not None]
    grid_columns = pictures_across(len(shown))
    grid_rows = -(-len(shown) // grid_columns)
    rows, columns = shown[0].shape
    width_in, title_in = 12.0, 0.25
    height_in = (width_in / grid_columns * rows / columns + title_in) * grid_rows + 0.4
    figure = Figure(figsize=(width_in, height_in))
    # Set, not constrained: measuring every label takes longer than all else that is drawn here.
    margins = {"left": 0.005, "right": 0.995, "bottom": 0.005, "top": 1.0 - (0.4 + title_in) / height_in}
    gaps = {"wspace": 0.02, "hspace": title_in / (width_in / grid_columns * rows / columns)}
    grid = figure.subplots(grid_rows, grid_columns, squeeze=False, gridspec_kw=margins | gaps).ravel()
    for axes, press in zip(grid, shown, strict=False):
        _draw_press(axes, press)
    for axes in grid[len(shown) :]:
        axes.set_axis_off()
    used = sum(len(press.balls) for press in presses)
    rejected = sum(len(press.rejected) for press in presses)
    title = f"{used} balls used (+, circle: trusted contact), {rejected} rejected (x)"
    if len(shown) < len(presses):
        title += f"; {len(shown)} of {len(presses)} presses shown, those with rejected balls first"
    figure.suptitle(title, y=1.0 - 0.1 / height_in, va="top")
    return figure


def _draw_press(axes: Axes, press: TrainingPress) -> None:
    rows, columns = press.shape
    if press.picture is not None:
        axes.imshow(press.picture, extent=(-0.5, columns - 0.5, rows - 0.5, -0.5))
    for ball in press.balls:
        axes.add_patch(Circle((ball.column, ball.row), ball.contact_radius_px, fill=False, color=KEPT_COLOUR, lw=1.2))
        axes.plot(ball.column, ball.row, "+", color=KEPT_COLOUR, ms=6, mew=1.0)
    for rejected in press.rejected:
        axes.plot(rejected.column, rejected.row, "x", color=REJECTED_COLOUR, ms=8, mew=1.6)
    if len(press.fitted) > 1:
        for one in press.fitted:
            place = (one.ball.column + 0.25 * one.ball.radius_px, one.ball.row - 0.25 * one.ball.radius_px)
            axes.annotate(str(one.number), place, color=KEPT_COLOUR, fontsize=7)
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.set_title(press.name, fontsize=8)
    axes.set_xticks([])
    axes.set_yticks([])


def residuals_figure(calibration: Calibration) -> Figure:
    """Return held-out error by slope and by ball, presses and balls named as in `balls_figure`."""
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    by_slope, by_ball = figure.subplots(1, 2, width_ratios=(1.0, 2.0))
    _draw_bands(by_slope, calibration)
    fitted = [(press.name, len(press.fitted), one) for press in calibration.presses for one in press.fitted]
    for kept, style in ((True, KEPT_BAR), (False, REJECTED_BAR)):
        places = [place for place, (_, _, one) in enumerate(fitted) if one.kept is kept]
        if places:
            by_ball.bar(places, [fitted[place][2].error_deg for place in places], **style)
    if not all(one.kept for _, _, one in fitted):
        by_ball.legend(frameon=False, ncols=2, loc="upper right")
    by_ball.margins(y=0.15)
    single = all(count == 1 for _, count, _ in fitted)
    names = [label if single else str(one.number) for label, _, one in fitted]
    step = -(-len(names) // MAX_NAMES)
    by_ball.set_xticks(range(0, len(names), step), names[::step], rotation=90 if single else 0, fontsize=7)
    by_ball.set_title("held-out error of each ball")
    by_ball.set_xlabel("press" if single else "number of the ball in its press (balls.png)")
    by_ball.set_ylabel("mean error of the normal, degrees")
    _separate_presses(by_ball, [] if single else [label for label, _, _ in fitted])
    return figure


def _separate_presses(axes: Axes, owners: Sequence[str]) -> None:
    """Draw a line between the balls of neighbouring presses, and label each press."""
    first = 0
    for label, group in groupby(owners):
        count = len(list(group))
        axes.axvline(first - 0.5, color="#999999", lw=0.8)
        axes.annotate(label, (first - 0.3, 0.97), xycoords=("data", "axes fraction"), fontsize=7, va="top")
        first += count


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
