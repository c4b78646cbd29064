"""Guided calibration: frames by button alone, fit, and the published bundle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.guided_calibration import (
    MAX_EXTRA,
    AcceptedPress,
    GuidedCalibration,
    LastCalibration,
    press_places,
)
from device.acquisition.scanner import BYTES_PER_PIXEL
from device.acquisition.selftest import check_light_visible
from device.bundles.calibration import BallRecord, CalibrationBundle, CalibrationRecord, PressRecord, RejectedRecord
from device.bundles.fingerprint import Fingerprint, SettingsRecord
from device.bundles.raw_frame import write_raw
from device.calibration.fit import InverseFit, dropped_ball
from device.errors import DeviceError, StoreError
from device.imaging.frame_light import Brightness
from device.inverse_map.model import MODEL_FILE, read_model, write_model
from device.inverse_map.skin_at_rest import SkinAtRest
from device.quick_look.solver import REST_FILE, measure_rest, write_rest
from device.store.store import BundleStore
from hal.errors import ButtonError
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import OperatorRequest

BUTTON_TIMEOUT_S: Final = 300.0
REFERENCE_FILE: Final = "reference.tif"


@dataclass(frozen=True, slots=True)
class CalibrationOutcome:
    """The published calibration and its fit."""

    bundle: CalibrationBundle
    fit: InverseFit


def calibrate(
    hardware: Hardware,
    store: BundleStore,
    ball_radius_mm: float,
    report_progress: Callable[[str], None],
    plan: CaptureSettings | None = None,
) -> CalibrationOutcome:
    """Guide through a calibration, publish it and make it active.

    report_progress : shows one line to the operator
    plan : exposure and currents, for example from `auto_exposure`; None: the board profile's

    Every press must show exactly the exposure and gain that the reference was granted.

    Raises
    ------
    CalibrationError
        A light is not visible, there are too few balls, or held-out balls disagree; the previous calibration stays
        active.
    HalError, FrameNotConfirmed, StoreError
        The hardware or the disk failed.
    """
    check_room(hardware, store)
    plan = plan or CaptureSettings.of_board(hardware)
    guide = GuidedCalibration(hardware.profile, ball_radius_mm, last_calibration(hardware, store, plan))
    while guide.progress.phase in {"reference", "press"}:
        report_progress(guide.progress.instruction)
        prompt_and_wait(hardware, guide.request)
        if guide.progress.phase == "reference":
            frame, plan = take_reference(hardware, plan, report_progress)
        else:
            frame = capture(hardware, plan)
        guide.add_frame(frame)
        if guide.progress.complaint:
            report_progress(f"  {guide.progress.complaint}.")
    if guide.progress.phase != "failed":  # its error says the same
        report_progress(guide.progress.instruction)
    return finish(hardware, store, plan, guide)


def check_room(hardware: Hardware, store: BundleStore) -> None:
    """Make room for every frame of a calibration as `BundleStore.make_room` does.

    Raises
    ------
    StoreError
        There is too little: the calibration is refused before its first frame.
    """
    rows, columns = hardware.camera.shape
    size_bytes = int(BYTES_PER_PIXEL * rows * columns) * (1 + len(press_places()) + MAX_EXTRA)
    if not store.scans_left(size_bytes):
        store.make_room(size_bytes)
    if not store.scans_left(size_bytes):
        raise StoreError(
            f"{store.root} has no room for a calibration ({size_bytes / 1e6:.0f} MB): offload scans or free space"
        )


def last_calibration(hardware: Hardware, store: BundleStore, plan: CaptureSettings) -> LastCalibration | None:
    """Return the active calibration if it is of this board, gel and lights and can be read; otherwise None."""
    with suppress(DeviceError):
        bundle = store.active_calibration()
        record, profile = bundle.record, hardware.profile
        present = Fingerprint.of(profile, plan.granted or plan.settings, plan.currents_ma)
        same = (record.board, record.gel_id) == (profile.name, profile.gel.id)
        if same and record.fingerprint.mismatch(present) is None:
            return LastCalibration(bundle.reference(), read_model(bundle.path(record.model_files[0])))
    return None


def take_reference(
    hardware: Hardware, plan: CaptureSettings, report_progress: Callable[[str], None]
) -> tuple[RawFrame, CaptureSettings]:
    """Return the reference after a check of every light, and the plan that holds presses to the reference's settings.

    Raises
    ------
    CalibrationError
        A light is not visible.
    HalError, FrameNotConfirmed
        The hardware failed.
    """
    for light in hardware.profile.lights:
        if flags := check_light_visible(hardware, plan, light):
            report_progress(
                f"Note: the driver reports {flags} at light {light.name}, which is visible: run `retroscan selftest`."
            )
    reference = capture(hardware, plan)
    return reference, replace(plan, granted=reference.granted)


def finish(
    hardware: Hardware, store: BundleStore, plan: CaptureSettings, guide: GuidedCalibration
) -> CalibrationOutcome:
    """Fit, publish and activate what a guide has collected. Errors as for `calibrate`."""
    fit = guide.fit()
    bundle = publish(hardware, store, plan, guide.reference, guide.presses, fit, guide.ball_radius_mm)
    store.activate(bundle.calibration_id)
    guide.succeed(bundle.calibration_id, Brightness.of_figures(bundle.record.figures))
    return CalibrationOutcome(bundle, fit)


def prompt_and_wait(hardware: Hardware, request: OperatorRequest) -> None:
    """Prompt the operator and block until button-down; the release is ignored.

    Raises
    ------
    ButtonError
        The button was not pushed within `BUTTON_TIMEOUT_S`, or it cannot be read.
    """
    hardware.operator.ask(request)
    if hardware.button.wait_for_push(BUTTON_TIMEOUT_S) is None:
        raise ButtonError(f"the button was not pushed within {BUTTON_TIMEOUT_S:.0f} s: start again")
    hardware.button.clear_presses()


def publish(
    hardware: Hardware,
    store: BundleStore,
    plan: CaptureSettings,
    reference: RawFrame,
    presses: Sequence[AcceptedPress],
    fit: InverseFit,
    ball_radius_mm: float,
) -> CalibrationBundle:
    """Publish a calibration without activating it.

    Raises
    ------
    StoreError
        The disk is full; nothing is left behind.
    """
    profile = hardware.profile
    rest = _rest_of(reference, presses, fit)
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
        pupil_height_mm=profile.pupil_height_mm,
        reference_file=REFERENCE_FILE,
        presses=tuple(_press_records(names, presses, fit, ball_radius_mm)),
        model_files=(MODEL_FILE,) if rest is None else (MODEL_FILE, REST_FILE),
        figures=report_figures(fit) | Brightness.of_frames(reference, [press.frame for press in presses]).figures(),
    )

    def write(directory: Path) -> None:
        write_raw(directory / REFERENCE_FILE, reference)
        for name, press in zip(names, presses, strict=True):
            write_raw(directory / name, press.frame)
        write_model(directory / MODEL_FILE, fit.map)
        if rest is not None:
            write_rest(directory / REST_FILE, rest)

    return store.publish_calibration(record, write)


def _rest_of(reference: RawFrame, presses: Sequence[AcceptedPress], fit: InverseFit) -> SkinAtRest | None:
    """Return the noise of untouched skin around the balls of presses; None where the field is too small."""
    balls = iter(fit.balls)
    shown = [(press.frame, [next(balls) for _ in press.balls]) for press in presses]
    return measure_rest(reference, shown)


def _press_records(
    names: Sequence[str], presses: Sequence[AcceptedPress], fit: InverseFit, ball_radius_mm: float
) -> list[PressRecord]:
    """Return a record per press: kept balls at their refined centres, rejected ones with the reason."""
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
    """Return the figures of a calibration's report, angles in degrees."""
    figures: dict[str, float | None] = {
        "held_out_error_deg": fit.held_out_deg,
        "steepest_deg": float(np.degrees(np.arctan(fit.map.max_trained_slope))),
        "balls_used": float(fit.kept.sum()),
        "balls_rejected": float((~fit.kept).sum()),
        "degree_in_position": float(fit.map.curve.position_degree),
    }
    bands = {f"error_from_{band.from_deg:.0f}_deg": band.error_deg for band in fit.bands}
    return figures | bands
