"""`retroscan calibrate`, `scan`, `run`, `selftest` and `lights-off`: what drives the instrument without its screens."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Annotated

from cyclopts import Parameter

from device.acquisition.auto_exposure import auto_exposure as find_exposure
from device.acquisition.auto_exposure import calibration_settings, keep_balance
from device.acquisition.calibrate import calibrate
from device.acquisition.instrument_lock import exclusive_instrument, open_exclusive
from device.acquisition.precise_capture import MOVIE_S, frames_that_fit, mode_fault
from device.acquisition.scanner import Scanner, ScanOutcome
from device.acquisition.selftest import selftest
from device.bundles.calibration import CalibrationRecord
from device.bundles.scan import Annotations, CaptureMode
from device.cli.calibrations import print_imports
from device.cli.console import (
    Given,
    LengthMm,
    Text,
    open_store,
    print_error,
    print_line,
    print_note,
    store_folder,
)
from device.cli.service import SdNotify, ServiceReport
from device.command_line import print_json
from device.errors import CaptureModeRefused
from device.imaging.frame_light import Brightness
from device.instrument.calibration_run import BALL_RADIUS_MM
from device.instrument.events import (
    CalibrationStep,
    Event,
    Failed,
    Info,
    PairingChanged,
    PowerOffRequested,
    PressRefused,
    ScanFinished,
    ZeroChecked,
)
from device.instrument.instrument import Instrument
from device.instrument.state import InstrumentState
from device.store.choices import with_active_gel
from device.store.registry_file import read_active
from hal.board_profile import load_board_profile
from hal.clock import SystemClock
from hal.factory import open_hardware
from hal.hardware import Hardware
from hal.interfaces import MayLift, PressObject


@Parameter(name="*")
@dataclass(frozen=True)
class Labels:
    """Labels that are stored with a scan.

    Attributes
    ----------
    job
        Job, stored with the scan.
    part
        Part, stored with the scan.
    operator
        Operator, stored with the scan.
    note
        Note, stored with the scan.
    """

    job: Text | None = None
    part: Text | None = None
    operator: Text | None = None
    note: Text | None = None


def calibrate_guided(
    *,
    ball_radius_mm: LengthMm = BALL_RADIUS_MM,
    auto_exposure: bool = False,
    balance: Annotated[bool, Parameter(show=False)] = False,
    options: Given,
) -> int:
    """Calibrate with guidance: a reference, then ball presses all over the field.

    Parameters
    ----------
    ball_radius_mm
        Radius of the calibration ball, mm.
    auto_exposure
        Set exposure and currents for gel and lights first; later calibrations of this gel keep them.
    balance
        The old name of --auto-exposure.
    """
    with open_exclusive(load_board_profile(options.board)) as hardware:
        store = open_store(options, hardware.clock)
        set_first = auto_exposure or balance
        fitted = with_active_gel(hardware, store.root)
        if set_first:
            keep_balance(fitted, store.root, find_exposure(fitted, ball_radius_mm, print_line).plan)
        plan = calibration_settings(fitted, store.root)
        outcome = calibrate(fitted, store, ball_radius_mm, print_line, plan)
    fit = outcome.fit
    error = "unknown" if fit.held_out_deg is None else f"{fit.held_out_deg:.2f} degrees"
    print_line(f"{int(fit.kept.sum())} balls used, {int((~fit.kept).sum())} rejected; error on held-out balls {error}.")
    _print_levels(outcome.bundle.record)
    print_line(f"Calibration {outcome.bundle.calibration_id} is active.")
    return 0


def scan_once(
    *,
    pressed: Annotated[str, Parameter(name="--object")] = "coin",
    labels: Labels | None = None,
    capture: CaptureMode = "single",
    json: bool = False,
    options: Given,
) -> int:
    """Wait for one press of the button and scan.

    Parameters
    ----------
    pressed
        What the twin's operator presses (ignored on a real board).
    capture
        single: one frame; average: the mean of several; lights: that, a frame under no light, and one under each light
        alone; movie: frames of half the size for some seconds, the best of which is the scan.
    json
        Print one JSON document instead of sentences.
    """
    with open_exclusive(load_board_profile(options.board), store=store_folder(options)) as hardware:
        read_active(store_folder(options))  # a store without a calibration is refused before anything is created
        if fault := mode_fault(capture, hardware):
            raise CaptureModeRefused(fault)
        store = open_store(options, hardware.clock)
        scanner = Scanner(with_active_gel(hardware, store.root), store)
        scanner.check_room(capture)
        scanner.measure_lights()
        hardware.operator.ask(PressObject(pressed))
        say = print_note if json else print_line
        if capture == "movie":
            most = frames_that_fit(hardware.camera.shape)
            say(f"A movie of {MOVIE_S:g} s or {most} frames: push the button, then press the object slowly.")
        else:
            say("Press the object into the gel, then push the button.")
        hardware.button.wait_for_push(None)
        _report(scanner.scan(annotations_of(labels), lambda: cue_lift(hardware, say), capture), json)
    return 0


def run(
    *,
    labels: Labels | None = None,
    ball_radius_mm: LengthMm = BALL_RADIUS_MM,
    pair_when_new: bool = False,
    options: Given,
) -> int:
    """Scan at every press of the button, without a screen; holding it for six seconds powers off.

    Parameters
    ----------
    pair_when_new
        Open the pairing window at the start if no workstation was ever paired.
    ball_radius_mm
        Radius of the calibration ball, mm.
    """
    profile = load_board_profile(options.board)
    with exclusive_instrument(profile):
        # The loop waits for a person: the twin runs in real time too.
        hardware = open_hardware(profile, SystemClock())
        store = open_store(options, hardware.clock)
        print_imports(store)
        with Instrument(hardware, store, ball_radius_mm=ball_radius_mm) as instrument:
            if (given := annotations_of(labels)) != Annotations():
                instrument.set_sticky(given)
            if pair_when_new:
                instrument.open_pairing_when_new()
            service = SdNotify.from_environment(os.environ)
            report = ServiceReport(service, hardware.clock)
            try:
                run_headless(instrument, print_line, print_error, lambda: _goes_on(report, instrument))
            finally:
                report.ended()
            service.power_off()
    return 0


def _goes_on(report: ServiceReport, instrument: Instrument) -> bool:
    report.turn(instrument.state)
    return instrument.state.activity != "off"


def check_parts(*, push: bool = False, json: bool = False, options: Given) -> int:
    """Test every part and name the faulty one.

    Parameters
    ----------
    push
        Also wait for a push of the button.
    json
        Print one JSON document instead of sentences.
    """
    found = []
    profile = load_board_profile(options.board)
    with exclusive_instrument(profile):
        for finding in selftest(open_hardware(profile), push):
            found.append(finding)
            if not json:
                print_line(f"{finding.state:8} {finding.part}: {finding.sentence}")
    if json:
        print_json(found)
    return 3 if any(finding.state == "failed" for finding in found) else 0


def lights_off(*, options: Given) -> int:
    """Switch all lights off."""
    with open_hardware(load_board_profile(options.board)).lights as lights:
        lights.off()
    return 0


def annotations_of(labels: Labels | None) -> Annotations:
    """Return the annotations that are stored with a scan."""
    return Annotations(**{name: text or None for name, text in asdict(labels or Labels()).items()})


def _report(outcome: ScanOutcome, as_json: bool) -> None:
    verdict = outcome.bundle.record.verdict
    if as_json:
        print_json({"scan": outcome.bundle.scan_id, "verdict": verdict, "quick_look_fault": outcome.quick_look_fault})
        return
    print_line(f"{verdict.level}: {verdict.reason} ({outcome.bundle.scan_id})")
    if outcome.quick_look_fault:
        print_line(f"No quick look: {outcome.quick_look_fault}")


def _print_levels(record: CalibrationRecord) -> None:
    """Print how much of the sensor's range the calibration uses."""
    if found := Brightness.of_figures(record.figures):
        print_line(f"Levels: {found.sentence}.")
        if found.warning:
            print_line(f"Note: {found.warning}.")


def cue_lift(hardware: Hardware, say: Callable[[str], None]) -> None:
    """Print that the object may be lifted; a closed output must not cost the scan."""
    with suppress(OSError):
        say("You may lift.")
    hardware.operator.ask(MayLift())


# `retroscan run`: the instrument without a screen. Button and indicator do the work, events become lines of text.

Print = Callable[[str], None]
PrintError = Callable[[object], None]


def run_headless(instrument: Instrument, print_line: Print, print_error: PrintError, go_on: Callable[[], bool]) -> None:
    """Serve the button until `go_on`, called after every turn, returns False; failures are printed."""
    is_announced, goes_on = False, True
    while goes_on:
        instrument.step()
        if not is_announced and instrument.state.activity != "out of order":
            is_announced = True
            _announce(instrument.state, print_line, print_error)
        for event in instrument.take_events():
            print_event(event, print_line, print_error)
        goes_on = go_on()


def _announce(state: InstrumentState, print_line: Print, print_error: PrintError) -> None:
    room = "" if state.scans_left is None else f" room for {state.scans_left} scans."
    if state.calibration.fault:
        print_error(f"no scans yet: {state.calibration.fault}")
    print_line(
        f"Ready:{room} Push the button to scan, hold it to pair, twice to calibrate, 6 s to power off; Ctrl-C stops."
    )


def print_event(event: Event, print_line: Print, print_error: PrintError) -> None:
    """Print an event as a line; events that the indicator alone shows print nothing."""
    match event:
        case ScanFinished():
            print_line(f"{event.verdict.level}: {event.verdict.reason} ({event.scan_id})")
            if event.fault:
                print_line(f"No quick look: {event.fault}")
        case PressRefused() | Failed():
            print_error(event.sentence)
        case Info() | PairingChanged() | ZeroChecked():
            print_line(event.sentence)
        case CalibrationStep(progress):
            if progress.complaint:
                print_error(f"{progress.complaint}.")
            (print_error if progress.phase == "failed" else print_line)(progress.instruction)
            if progress.brightness and progress.brightness.warning:
                print_error(progress.brightness.warning)
        case PowerOffRequested():
            print_line("The power may be switched off.")
        case _:
            pass
