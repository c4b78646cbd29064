"""The instrument without a screen: button and indicator do the work, and what happens is said in lines of text."""

from __future__ import annotations

from collections.abc import Callable

from device.session.events import (
    CalibrationStep,
    Event,
    Failed,
    PairingChanged,
    PowerOffAsked,
    PressRefused,
    ScanFinished,
    Told,
    ZeroChecked,
)
from device.session.instrument import Instrument
from device.session.state import InstrumentState


def run_headless(
    instrument: Instrument, tell: Callable[[str], None], complain: Callable[[object], None], go_on: Callable[[], bool]
) -> None:
    """Serve the button until `go_on`, asked after every turn, says no.

    What fails is complained of, and the next push is heard.
    """
    is_announced, goes_on = False, True
    while goes_on:
        instrument.step()
        if not is_announced and instrument.state.activity != "out of order":
            is_announced = True
            _announce(instrument.state, tell, complain)
        for event in instrument.take_events():
            say(event, tell, complain)
        goes_on = go_on()


def _announce(state: InstrumentState, tell: Callable[[str], None], complain: Callable[[object], None]) -> None:
    room = "" if state.scans_left is None else f" room for {state.scans_left} scans."
    if state.calibration.fault:
        complain(f"no scans yet: {state.calibration.fault}")
    tell(f"Ready:{room} Push the button to scan, hold it to pair, twice to calibrate; Ctrl-C stops.")


def say(event: Event, tell: Callable[[str], None], complain: Callable[[object], None]) -> None:
    """One event as a line; cues that the indicator has shown already are not repeated."""
    match event:
        case ScanFinished():
            tell(f"{event.verdict.level}: {event.verdict.reason} ({event.scan_id})")
            if event.fault:
                tell(f"No quick look: {event.fault}")
        case PressRefused() | Failed():
            complain(event.sentence)
        case Told() | PairingChanged() | ZeroChecked():
            tell(event.sentence)
        case CalibrationStep(progress):
            if progress.complaint:
                complain(f"{progress.complaint}.")
            (complain if progress.phase == "failed" else tell)(progress.instruction)
            if progress.brightness and progress.brightness.warning:
                complain(progress.brightness.warning)
        case PowerOffAsked():
            tell("The power may be switched off.")
        case _:
            pass
