"""The active calibration's own balls in the quick look: what their radius reads as, beside what is known of it."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.bundles.calibration import CalibrationBundle, PressRecord
from device.bundles.raw_frame import read_raw
from device.errors import DeviceError
from device.imaging.flat_field import bin_bayer
from device.quick_look.ball_bias import BallBias, BallReading
from device.quick_look.check_measure import read_ball
from device.quick_look.solver import QuickLookModel, quick_look

MAX_PRESSES: Final = 4
"""Presses that are read, those nearest to the middle of the field: each takes a full frame from the disk."""


def calibration_ball_bias(calibration: CalibrationBundle, model: QuickLookModel) -> BallBias | None:
    """The bias of balls' radius in this calibration's quick looks; None where no press of it can be read."""
    record = calibration.record
    rows, columns = record.shape

    def from_middle(press: PressRecord) -> float:
        ball = press.balls[0]
        return float(np.hypot(ball.row - rows / 2.0, ball.column - columns / 2.0))

    readings: list[BallReading] = []
    stated_um = []
    for press in sorted((press for press in record.presses if len(press.balls) == 1), key=from_middle)[:MAX_PRESSES]:
        try:
            look = quick_look(bin_bayer(read_raw(calibration.path(press.file)), model.binning), model)
            readings.append(read_ball(look.gradients, look.height))
        except DeviceError:
            continue
        stated_um.append(1e3 * press.ball_radius_mm)
    lights_mm = [light.position_mm for light in record.fingerprint.lights]
    return BallBias.of(readings, stated_um, lights_mm) if readings else None
