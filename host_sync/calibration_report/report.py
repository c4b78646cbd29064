"""The calibration report: a record and the pictures by which a person judges it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any, Final

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.pixel_pitch import PixelPitch
from host_sync.calibration.training_press import TrainingPress, pictures_across
from host_sync.johnson2009.model import PaperModel
from host_sync.render.figures import figure_png

SCHEMA = "retrograph.calibration-report/1"
REPORT_FILE = "report.json"
BALL_PICTURES = ("balls.png", "residuals.png")
"""One picture of all; `retrosync calibrate` adds it."""

DPI: Final = 120
PAPER_PICTURES = ("reflectance-maps.png", "ambiguous-bins.png")


def report_files(calibration: Calibration) -> dict[str, bytes]:
    """Return contents of `report.json` and the pictures, by name."""
    # matplotlib takes longer to load than a kept calibration takes to read, whose report is drawn already.

    drawn = (balls_figure(calibration.presses), residuals_figure(calibration))
    figures = dict(zip(BALL_PICTURES, drawn, strict=True))
    if calibration.paper is not None:
        from host_sync.calibration_report.paper_figures import ambiguity_figure, reflectance_figure

        drawn = (reflectance_figure(calibration.paper), ambiguity_figure(calibration.paper))
        figures |= dict(zip(PAPER_PICTURES, drawn, strict=True))
    record = msgspec.json.format(msgspec.json.encode(report_record(calibration)), indent=2)
    return {REPORT_FILE: record} | {name: figure_png(figure, DPI) for name, figure in figures.items()}


def report_record(calibration: Calibration) -> dict[str, Any]:
    """Return contents of `report.json`: angles in degrees, positions in pixels, unknown values null."""
    inverse = calibration.inverse
    assessment = calibration.assessment
    return {
        "schema": SCHEMA,
        "calibration_id": calibration.calibration_id,
        "passed": assessment.passed,
        "checks": [
            {"name": c.name, "value": c.value, "limit": c.limit, "kind": c.kind, "passed": c.passed}
            for c in assessment.checks
        ],
        "notes": assessment.notes,
        "frames_cannot_be_checked_for": calibration.frame_model.blind,
        "next_presses": assessment.coverage.next_presses(),
        "coverage": assessment.coverage,
        "pixel_pitch_um": calibration.pitch_um,
        "scale_uncertainty": assessment.scale,
        "measured_pixel_pitch": _pitch_record(assessment.pitch),
        "reference": "frame of the untouched skin" if calibration.has_reference else "fitted to the frames",
        "ball_centres": calibration.centres,
        "preferred_method": calibration.preferred,
        "held_out_error_deg": {method: _number(error) for method, error in calibration.held_out_deg.items()},
        "held_out_error_by_slope": [
            {"from_deg": band.from_deg, "to_deg": band.to_deg, "error_deg": band.error_deg, "pixels": band.pixels}
            for band in inverse.bands
        ],
        "gain_by_slope": [
            {"from_deg": band.from_deg, "to_deg": band.to_deg, "gain": band.gain, "sigma": band.sigma}
            for band in inverse.gains
        ],
        "gain_of": "held-out balls" if inverse.of_another_radius is None else "balls of another radius",
        "steepest_slope_deg": float(np.degrees(np.arctan(inverse.map.max_trained_slope))),
        "reads": "intensity" if inverse.map.near is None else "slopes of a matt skin under near lights",
        "sources": len(calibration.light.model.sources),
        "confirmed": calibration.light.confirmed,
        "albedo": calibration.light.model.albedo,
        "held_out_intensity_error": calibration.light.model.sigma.tolist(),
        "degree_in_colour": inverse.map.own.colour_degree,
        "waves_of_colour": inverse.map.own.waves.count,
        "degree_in_position": inverse.map.own.position_degree,
        "share_of_light": inverse.map.light.share if inverse.map.light else 0.0,
        "share_of_root": inverse.map.root.share if inverse.map.root else 0.0,
        "slope_error": calibration.slope_error,
        "shrinkage": calibration.shrinkage.record() if calibration.shrinkage else None,
        "slope_noise": calibration.slope_noise,
        "paper": _paper_record(calibration.paper),
        "presses": [
            {
                "name": press.name,
                "image": press.source or None,
                "fault": press.error or None,
                "balls": [
                    {"x": ball.column, "y": ball.row, "r": ball.contact_radius_px, "radius_px": ball.radius_px}
                    for ball in press.balls
                ],
                "rejected": [{"x": ball.column, "y": ball.row, "reason": ball.reason} for ball in press.rejected],
            }
            for press in calibration.presses
        ],
    }


def _pitch_record(pitch: PixelPitch | None) -> dict[str, Any] | None:
    """Return the pixel pitch from ball grids; lengths in µm per pixel unless the name says otherwise."""
    if pitch is None:
        return None
    return {
        "stated_um": pitch.stated_um,
        "pitch_um": pitch.pitch_um,
        "sigma_um": pitch.sigma_um,
        "readings": [
            {
                "press": reading.press,
                "grid_pitch_mm": reading.grid.pitch_mm,
                "grid_pitch_tolerance_mm": reading.grid.tolerance_mm,
                "pitch_um": reading.pitch_um,
                "sigma_um": reading.sigma_um,
                "scatter_um": reading.scatter_um,
                "bias_um": reading.bias_um,
                "least_um": reading.least_um,
                "most_um": reading.most_um,
                "balls": reading.balls,
                "pose": reading.pose.model.name,
                "fitted_px": reading.pose.fitted_px,
                "held_out_px": reading.pose.held_out_px,
            }
            for reading in pitch.readings
        ],
    }


def _paper_record(model: PaperModel | None) -> dict[str, Any] | None:
    """Return what the paper's model leaves unexplained; null where it was not fitted."""
    if model is None:
        return None
    return {
        "residual_order_2": model.residual_order_2,
        "residual_order_5": model.residual_order_5,
        "ambiguous_bin_share": model.table.ambiguous_fraction,
        "filled_bins": model.table.filled_bins,
    }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


# Pictures of a calibration's balls: where they were found, which were rejected, how well each was explained.

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
