"""`retroscan run`: the instrument without a screen. Button and indicator do the work, events become lines of text."""

from __future__ import annotations

from collections.abc import Callable

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
