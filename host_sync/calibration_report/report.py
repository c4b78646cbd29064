"""The calibration report: a record and the pictures by which a person judges it, and its summary in lines of text."""

from __future__ import annotations

from typing import Any, Final

import msgspec
import numpy as np

from device.calibration.acceptance import Check
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.pixel_pitch import PixelPitch
from host_sync.johnson2009.model import PaperModel
from host_sync.render.picture_file import figure_png


def calibration_lines(calibration: Calibration) -> tuple[str, ...]:
    """Return the verdict and key values; then what to press next, and notes, one sentence each."""
    assessment = calibration.assessment
    failed = [_failed(check) for check in assessment.checks if not check.passed]
    balls = sum(len(press.balls) for press in calibration.presses)
    figures = [f"{balls} balls"]
    if calibration.inverse.held_out_deg is not None:
        figures.append(f"held-out error {calibration.inverse.held_out_deg:.2f} degrees")
    share = assessment.scale.height_share
    missing = " and ".join(assessment.scale.not_measured)
    figures.append(f"height scale ± {share:.2%}" if share is not None else f"± of the height scale unknown ({missing})")
    verdict = f"did not pass: {', '.join(failed)}" if failed else "passed"
    following = assessment.coverage.next_presses() if failed else ()
    return (
        f"calibration {verdict} ({', '.join(figures)})",
        *following,
        *assessment.notes,
        *calibration.frame_model.blind,
    )


def _failed(check: Check) -> str:
    return f"{check.name} {check.words}"


SCHEMA = "retrograph.calibration-report/1"
REPORT_FILE = "report.json"
BALL_PICTURES = ("balls.png", "residuals.png")
"""One picture of all; `retrosync calibrate` adds it."""

DPI: Final = 120
PAPER_PICTURES = ("reflectance-maps.png", "ambiguous-bins.png")


def report_files(calibration: Calibration) -> dict[str, bytes]:
    """Return contents of `report.json` and the pictures, by name."""
    # matplotlib takes longer to load than a kept calibration takes to read, whose report is drawn already.
    from host_sync.calibration_report.overview import balls_figure, residuals_figure

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
