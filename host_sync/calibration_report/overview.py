"""Pictures of a calibration: the overview, and its balls.

The overview shows presses with their balls, used or not and why, errors by place, and the skin at rest. Balls are shown
where they were found, with how well each was explained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap
from typing import Any, Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from device.balls.detector import RejectedBall
from device.balls.sphere import Ball
from device.surface import HeightMap
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.preparation import TrainingPress, pictures_across
from host_sync.calibration_report.report import calibration_lines

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
        _draw_press_balls(axes, press)
    for axes in grid[len(shown) :]:
        axes.set_axis_off()
    used = sum(len(press.balls) for press in presses)
    rejected = sum(len(press.rejected) for press in presses)
    title = f"{used} balls used (+, circle: trusted contact), {rejected} rejected (x)"
    if len(shown) < len(presses):
        title += f"; {len(shown)} of {len(presses)} presses shown, those with rejected balls first"
    figure.suptitle(title, y=1.0 - 0.1 / height_in, va="top")
    return figure


def _draw_press_balls(axes: Axes, press: TrainingPress) -> None:
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


WIDTH_IN: Final = 14.0
MAPS_IN: Final = 4.2
LINE_IN: Final = 0.2
LINE_LETTERS: Final = 165
MAX_LINES: Final = 8
LARGE_DEG: Final = 6.0
"""An error that is drawn in the last colour, degrees, where none is larger."""


def overview_figure(calibration: Calibration, at_rest: HeightMap | None, why_not: str) -> Figure:
    """Return the picture.

    at_rest : heights of the reference, read as a scan; None where it could not be read
    why_not : why `at_rest` is None
    """
    lines = [line for text in calibration_lines(calibration) for line in wrap(text, LINE_LETTERS)]
    if len(lines) > MAX_LINES:
        lines = [
            *lines[: MAX_LINES - 1],
            f"and {len(lines) - MAX_LINES + 1} lines more: retrosync calibrate prints them",
        ]
    shown = [_shown(press) for press in calibration.presses if press.picture is not None]
    head_in = LINE_IN * (len(lines) + 3)
    sheet_in = head_in + sheet_height_in(shown, WIDTH_IN)
    figure = Figure(figsize=(WIDTH_IN, sheet_in + MAPS_IN))
    (above,), (below,) = figure.subfigures(2, 1, height_ratios=(sheet_in, MAPS_IN), squeeze=False)
    draw_sheet(above, shown, WIDTH_IN, head_in)
    above.text(0.01, 1.0 - 0.6 * LINE_IN / sheet_in, _title(calibration), va="top", fontsize=12, weight="bold")
    top = 1.0 - 2.4 * LINE_IN / sheet_in
    above.text(0.01, top, "\n".join(lines), va="top", fontsize=9, linespacing=1.3)
    places, rest = below.subplots(1, 2, gridspec_kw={"left": 0.05, "right": 0.95, "bottom": 0.1, "top": 0.88})
    _draw_errors(places, calibration.presses)
    _draw_rest(rest, at_rest, why_not)
    return figure


def _title(calibration: Calibration) -> str:
    used = sum(bool(press.balls) for press in calibration.presses)
    pictured = sum(press.picture is not None for press in calibration.presses)
    count = len(calibration.presses)
    others = f", {pictured} of them shown" if pictured < count else ""
    passed = "passed" if calibration.assessment.passed else "DID NOT PASS"
    return f"Calibration {calibration.calibration_id} {passed}: {used} of {count} presses are used{others}"


def _shown(press: TrainingPress) -> ShownPress:
    name = f"{press.name} {press.source}".strip()
    errors = [one.error_deg for one in press.fitted if one.kept]
    words = f"used, held-out error {np.mean(errors):.1f}°" if errors else "used"
    if not press.balls:
        words = f"not used: {press.error or '; '.join(ball.reason for ball in press.rejected) or 'no ball'}"
    return ShownPress(name, press.shape, press.picture, press.balls, press.rejected, words)


def _draw_errors(axes: Axes, presses: Sequence[TrainingPress]) -> None:
    """Held-out error of each ball at its place in the field."""
    rows, columns = presses[0].shape
    fitted = [one for press in presses for one in press.fitted]
    kept = [one for one in fitted if one.kept]
    dropped = [one for one in fitted if not one.kept]
    limit = max(LARGE_DEG, *(one.error_deg for one in kept)) if kept else LARGE_DEG
    for one in kept:
        axes.annotate(f"{one.error_deg:.1f}", (one.ball.column, one.ball.row), fontsize=6, ha="center", va="center")
    drawn = axes.scatter(
        [one.ball.column for one in kept],
        [one.ball.row for one in kept],
        s=260,
        c=[one.error_deg for one in kept],
        cmap="YlOrRd",
        vmin=0.0,
        vmax=limit,
        edgecolors="#555555",
        linewidths=0.5,
    )
    axes.plot([one.ball.column for one in dropped], [one.ball.row for one in dropped], "kx", ms=7)
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_title("held-out error by place, degrees (x: ball that is not used)", fontsize=9)
    axes.tick_params(labelsize=7)
    figure = axes.figure
    figure.colorbar(drawn, ax=axes, shrink=0.9)


def _draw_rest(axes: Axes, at_rest: HeightMap | None, why_not: str) -> None:
    """The reference read as a scan: untouched skin is flat."""
    if at_rest is None:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "\n".join(wrap(why_not, 60)), ha="center", va="center", fontsize=10)
        return
    z_um = at_rest.z_um
    seen = z_um[np.isfinite(z_um)]
    centre = float(np.median(seen)) if seen.size else 0.0
    limit = max(float(np.percentile(np.abs(seen - centre), 99.0)) if seen.size else 0.0, 1e-3)
    step = max(1, z_um.shape[1] // 700)
    rows, columns = z_um.shape
    extent = (-0.5, columns - 0.5, rows - 0.5, -0.5)
    drawn = axes.imshow(z_um[::step, ::step] - centre, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=extent)
    rms = float(np.std(seen)) if seen.size else float("nan")
    axes.set_title(f"reference read as a scan, µm: flat within {rms:.2g} µm root mean square", fontsize=9)
    axes.tick_params(labelsize=7)
    axes.figure.colorbar(drawn, ax=axes, shrink=0.9)


# Pictures of presses side by side: where balls are, which are used, and why the others are not.

USED_COLOUR, REJECTED_COLOUR, GIVEN_COLOUR = "#ffffff", "#ffb000", "#40e0ff"
UNUSED_TITLE: Final = "#a03000"
TITLE_IN: Final = 0.38
_CHARACTERS_PER_INCH: Final = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class ShownPress:
    """A press as a sheet shows it.

    shape : (H, W) of its frame
    picture : uint8 array of shape (h, w, 3); None where it could not be read
    words : what became of it, after its name
    given : circles that were drawn by hand and are used as they are
    """

    name: str
    shape: tuple[int, int]
    picture: NDArray[np.uint8] | None
    balls: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    words: str
    given: tuple[Ball, ...] = ()

    @property
    def is_used(self) -> bool:
        """True if it shows a ball that is used."""
        return bool(self.balls or self.given)


def sheet_height_in(presses: Sequence[ShownPress], width_in: float) -> float:
    """Return the height of a sheet of these presses that is so wide."""
    across = pictures_across(len(presses))
    rows, columns = presses[0].shape
    return (width_in / across * rows / columns + TITLE_IN) * -(-len(presses) // across)


def draw_sheet(place: Figure | SubFigure, presses: Sequence[ShownPress], width_in: float, head_in: float) -> None:
    """Draw presses in rows under a head of `head_in`; a title says what became of each."""
    across = pictures_across(len(presses))
    rows, columns = presses[0].shape
    picture_in = width_in / across * rows / columns
    height_in = head_in + sheet_height_in(presses, width_in)
    # Set, not constrained: measuring every label takes longer than all else that is drawn here.
    margins = {"left": 0.005, "right": 0.995, "bottom": 0.005, "top": 1.0 - (head_in + TITLE_IN) / height_in}
    gaps = {"wspace": 0.03, "hspace": TITLE_IN / picture_in}
    count = -(-len(presses) // across)
    grid = place.subplots(count, across, squeeze=False, gridspec_kw=margins | gaps).ravel()
    for axes, press in zip(grid, presses, strict=False):
        _draw_press(axes, press, width_in / across)
    for axes in grid[len(presses) :]:
        axes.set_axis_off()


def _draw_press(axes: Axes, press: ShownPress, width_in: float) -> None:
    rows, columns = press.shape
    if press.picture is not None:
        axes.imshow(press.picture, extent=(-0.5, columns - 0.5, rows - 0.5, -0.5))
    for balls, colour in ((press.balls, USED_COLOUR), (press.given, GIVEN_COLOUR)):
        for ball in balls:
            axes.add_patch(Circle((ball.column, ball.row), ball.contact_radius_px, fill=False, color=colour, lw=1.2))
            axes.plot(ball.column, ball.row, "+", color=colour, ms=5, mew=1.0)
    for one in press.rejected:
        axes.plot(one.column, one.row, "x", color=REJECTED_COLOUR, ms=7, mew=1.6)
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    wide = max(int(1.35 * _CHARACTERS_PER_INCH * width_in), 12)
    lines = [*wrap(press.name, wide)[:1], *wrap(press.words, wide)]
    text = "\n".join(lines[:3] if len(lines) <= 3 else [*lines[:2], lines[2][: wide - 1] + "…"])
    axes.set_title(text, fontsize=6, pad=2.0, color="black" if press.is_used else UNUSED_TITLE)
    axes.set_xticks([])
    axes.set_yticks([])


def reduced_picture(values: NDArray[np.floating], width_px: int) -> NDArray[np.uint8]:
    """Return linear light as a picture of about this width: the brightest hundredth is white."""
    factor = max(1, values.shape[1] // width_px)
    size = (values.shape[1] // factor, values.shape[0] // factor)
    small = cv2.resize(np.asarray(values[..., :3], np.float32), size, interpolation=cv2.INTER_AREA)
    small = small if small.ndim == 3 else small[..., None].repeat(3, axis=-1)
    white = max(float(np.percentile(small, 99.0)), 1e-6)
    return np.asarray(np.rint(255.0 * np.clip(small / white, 0.0, 1.0) ** 0.45), np.uint8)
