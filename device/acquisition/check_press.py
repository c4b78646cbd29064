"""A press of the check standard: its value, or the refusal of a press that does not show the standard.

A press that does not show it says nothing about the instrument, and is no check. Under drifted light a right press may
not show it either, and that is a failed check: such a frame is looked at again with the light's drift taken out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from device.bundles.calibration import CalibrationBundle, PressRecord
from device.bundles.check import CheckStandard
from device.bundles.raw_frame import read_raw
from device.errors import DeviceError
from device.imaging.flat_field import bin_bayer
from device.imaging.frame_light import Levels
from device.quality.verdict import Evidence
from device.quick_look.check_measure import BallBias, BallReading, CheckNotMeasured, measure_standard, read_ball
from device.quick_look.solver import QuickLook, QuickLookModel, quick_look
from device.store.checks import MAX_CORRECTED_ERROR, CheckMeasure
from hal.frame import RawFrame

MAX_PRESSES: Final = 4
"""Presses that are read, those nearest to the middle of the field: each takes a full frame from the disk."""


def calibration_ball_bias(calibration: CalibrationBundle, model: QuickLookModel) -> BallBias | None:
    """Return the bias of balls' radius in this calibration's quick looks; None where no press of it can be read."""
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


NOT_SEEN = "no standard seen"


class BallInDoubt(DeviceError):
    """The press shows another common ball than the standard: the operator is asked which one lies on the gel."""


def measure_check(
    standard: CheckStandard,
    look: QuickLook | None,
    evidence: Evidence,
    frame: RawFrame,
    model: QuickLookModel,
    levels: Levels,
    calibration: CalibrationBundle,
    *,
    asks: bool = False,
) -> CheckMeasure:
    """Return the check standard as a press shows it.

    look : of the press; None if it has none
    evidence : of the press, with the lights as measured since
    frame : without ambient light
    levels : intensity of untouched skin in R, G and B, 1 as calibrated
    calibration : whose own balls show how much too large balls read
    asks : whether an operator can be asked about a look-alike

    Raises
    ------
    CheckNotMeasured
        The press does not show the standard, or cannot be used at all.
    BallInDoubt
        It shows a look-alike under right light; says what to ask.
    """
    verdict, fault = evidence.verdict(), evidence.light_fault
    if verdict.level == "retake":
        raise CheckNotMeasured(f"{NOT_SEEN}: {verdict.reason}")
    if look is None:
        raise CheckNotMeasured(f"{NOT_SEEN}: the press has no quick look")
    if evidence.lacks_contact:
        raise CheckNotMeasured(f"{NOT_SEEN}: press {standard.name} into the gel")
    bias = calibration_ball_bias(calibration, model) if standard.kind == "ball" else None
    own_error = MAX_CORRECTED_ERROR if bias else None
    try:
        measured = CheckMeasure(measure_standard(standard, look, bias), own_error=own_error)
    except CheckNotMeasured as error:
        if not fault:
            raise CheckNotMeasured(f"{NOT_SEEN}: {error}") from error
    else:
        if asks and not fault and (question := measured.question(standard)):
            raise BallInDoubt(question)
        return measured
    try:
        measure_standard(standard, _under_levels(frame, model, levels), bias)
    except CheckNotMeasured as error:
        raise CheckNotMeasured(f"{NOT_SEEN}: {error}; {fault}") from error
    return CheckMeasure(None, fault[:200], own_error)


def _under_levels(frame: RawFrame, model: QuickLookModel, levels: Levels) -> QuickLook:
    """Return the quick look of a frame under lights that have drifted to these levels."""
    drifted = replace(model, flat_field=model.flat_field * np.asarray(levels, np.float32))
    return quick_look(bin_bayer(frame, model.binning), drifted)
