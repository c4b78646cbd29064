"""A guided calibration as a published bundle: raw frames, fitted map, and a record of what each press taught."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from device.ball import Ball, BallSamples
from device.ball_finder import RejectedBall
from device.bundle_store import BundleStore
from device.calibration_bundle import BallRecord, CalibrationBundle, CalibrationRecord, PressRecord, RejectedRecord
from device.dropped_ball import dropped_ball
from device.exposure_levels import Brightness
from device.fingerprint import Fingerprint
from device.inverse_fit import InverseFit
from device.model_file import MODEL_FILE, write_model
from device.raw_file import write_raw
from device.scanning.capture import CapturePlan
from device.settings_record import SettingsRecord
from hal.frame import RawFrame
from hal.hardware import Hardware

REFERENCE_FILE: Final = "reference.tif"


@dataclass(frozen=True, slots=True, eq=False)
class AcceptedPress:
    """One press that shows a ball.

    balls : in full-size pixels
    rejected : in full-size pixels, with the reason
    samples : of the pixels inside the balls, at their full-size places
    """

    frame: RawFrame
    balls: tuple[Ball, ...]
    rejected: tuple[RejectedBall, ...]
    samples: BallSamples


def publish(
    hardware: Hardware,
    store: BundleStore,
    plan: CapturePlan,
    reference: RawFrame,
    presses: Sequence[AcceptedPress],
    fit: InverseFit,
    ball_radius_mm: float,
) -> CalibrationBundle:
    """The published calibration; it is not active yet.

    Raises
    ------
    StoreError
        The disk is full; nothing is left behind.
    """
    profile = hardware.profile
    names = [f"press-{number:02d}.tif" for number in range(len(presses))]
    record = CalibrationRecord(
        identity=store.next_identity("calibrations"),
        created=store.wall_time(),
        board=profile.name,
        gel_id=profile.gel.id,
        pixel_pitch_um=profile.sensor.pixel_pitch_um,
        shape=reference.shape,
        fingerprint=Fingerprint.of(profile, reference.granted, plan.currents_ma),
        asked=SettingsRecord.of(plan.settings),
        reference_file=REFERENCE_FILE,
        presses=tuple(_press_records(names, presses, fit, ball_radius_mm)),
        model_files=(MODEL_FILE,),
        figures=report_figures(fit) | Brightness.of_frames(reference, [press.frame for press in presses]).figures(),
    )

    def write(directory: Path) -> None:
        write_raw(directory / REFERENCE_FILE, reference)
        for name, press in zip(names, presses, strict=True):
            write_raw(directory / name, press.frame)
        write_model(directory / MODEL_FILE, fit.map)

    return store.publish_calibration(record, write)


def _press_records(
    names: Sequence[str], presses: Sequence[AcceptedPress], fit: InverseFit, ball_radius_mm: float
) -> list[PressRecord]:
    """What each press taught: kept balls at their refined centres, the others with the reason."""
    records = []
    first = 0
    for name, press in zip(names, presses, strict=True):
        span = range(first, first + len(press.balls))
        first += len(press.balls)
        kept = tuple(BallRecord.of(fit.balls[i]) for i in span if fit.kept[i])
        dropped = tuple(dropped_ball(fit, i) for i in span if not fit.kept[i])
        rejected = tuple(
            RejectedRecord(column=ball.column, row=ball.row, reason=ball.reason) for ball in dropped + press.rejected
        )
        records.append(PressRecord(file=name, ball_radius_mm=ball_radius_mm, balls=kept, rejected=rejected))
    return records


def report_figures(fit: InverseFit) -> dict[str, float | None]:
    """The numbers of a calibration's report, angles in degrees."""
    figures: dict[str, float | None] = {
        "held_out_error_deg": fit.held_out_deg,
        "steepest_deg": float(np.degrees(np.arctan(fit.map.steepest))),
        "balls_used": float(fit.kept.sum()),
        "balls_rejected": float((~fit.kept).sum()),
        "degree_in_position": float(fit.map.curve.position_degree),
    }
    bands = {f"error_from_{band.from_deg:.0f}_deg": band.error_deg for band in fit.bands}
    return figures | bands
