"""Guided calibration by button alone: a reference in air, a ball pressed all over the field, a model fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from device.bundle_store import BundleStore
from device.calibration_bundle import CalibrationBundle
from device.exposure_levels import Brightness
from device.inverse_fit import InverseFit
from device.scanning.calibration_files import publish
from device.scanning.capture import CapturePlan, capture
from device.scanning.guided_calibration import GuidedCalibration
from device.scanning.pushing import await_push
from device.scanning.shining import check_shines
from hal.frame import RawFrame
from hal.hardware import Hardware


@dataclass(frozen=True, slots=True)
class CalibrationOutcome:
    """The published calibration and what its fit says."""

    bundle: CalibrationBundle
    fit: InverseFit


def calibrate(
    hardware: Hardware,
    store: BundleStore,
    ball_radius_mm: float,
    tell: Callable[[str], None],
    plan: CapturePlan | None = None,
) -> CalibrationOutcome:
    """Guide through a calibration, publish it and make it active.

    tell : shows one line to the person at the instrument
    plan : exposure and currents, such as `balance` found; the board profile's when none is given

    Every press is held to the very exposure and gain that the reference was granted.

    Raises
    ------
    CalibrationError
        A light does not shine, too few balls, or held-out balls disagree; the calibration before stays active.
    HalError, FrameNotProven, StoreError
        The hardware or the disk refused.
    """
    plan = plan or CapturePlan.of_board(hardware)
    guide = GuidedCalibration(hardware.profile, ball_radius_mm)
    while guide.progress.phase in {"reference", "press"}:
        tell(guide.progress.instruction)
        await_push(hardware, guide.request)
        if guide.progress.phase == "reference":
            frame, plan = take_reference(hardware, plan, tell)
        else:
            frame = capture(hardware, plan)
        guide.take(frame)
        if guide.progress.complaint:
            tell(f"  {guide.progress.complaint}.")
    tell(guide.progress.instruction)
    return finish(hardware, store, plan, guide)


def take_reference(hardware: Hardware, plan: CapturePlan, tell: Callable[[str], None]) -> tuple[RawFrame, CapturePlan]:
    """The reference, every light seen to shine before, and the plan that holds the presses to what it was granted.

    Raises
    ------
    CalibrationError
        A light is not seen.
    HalError, FrameNotProven
        The hardware refused.
    """
    for light in hardware.profile.lights:
        if told := check_shines(hardware, plan, light):
            tell(f"Note: the driver says {told} at light {light.name}, which is seen: run `retroscan selftest`.")
    reference = capture(hardware, plan)
    return reference, replace(plan, granted=reference.granted)


def finish(hardware: Hardware, store: BundleStore, plan: CapturePlan, guide: GuidedCalibration) -> CalibrationOutcome:
    """Fit, publish and put in force what a guide has gathered. Errors as for `calibrate`."""
    fit = guide.fit()
    bundle = publish(hardware, store, plan, guide.reference, guide.presses, fit, guide.ball_radius_mm)
    store.activate(bundle.calibration_id)
    guide.succeed(bundle.calibration_id, Brightness.of_figures(bundle.record.figures))
    return CalibrationOutcome(bundle, fit)
