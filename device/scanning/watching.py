"""Scanning at every push of the button: cues, a long push, and pushes that come while busy.

The frame is taken while the button goes down, so that cue and frame follow the finger; a push that turns out to be a
long one is then not published.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Final

from device.bundle_store import BundleStore
from device.errors import DeviceError
from device.scan_bundle import Annotations
from device.scanning.darkness import next_push
from device.scanning.scanner import Scanner, ScanOutcome
from device.scanning.supervision import Supervisor
from hal.errors import HalError
from hal.hardware import Hardware
from hal.interfaces import Cue

LONG_PUSH_S: Final = 2.0
"""A button held this long asks for something else than a scan."""


def watch(
    hardware: Hardware,
    store: BundleStore,
    annotations: Annotations,
    report: Callable[[ScanOutcome], None],
    complain: Callable[[object], None],
    tell: Callable[[str], None],
    supervisor: Supervisor,
) -> None:
    """Scan at every push until the button says no more; what fails is complained of, and the next push is heard.

    supervisor : is told when the loop begins and in each of its turns, and how it is watched bounds each wait

    Raises
    ------
    DeviceError
        No scan is possible at all: no calibration, or no room.
    HalError
        The button cannot be read any more.
    """
    scanner = Scanner(hardware, store)
    room = f"room for {scanner.check_room()} scans"
    tell(f"Ready: {room}. Push the button to scan, Ctrl-C to stop.")
    _show(hardware, "idle")
    supervisor.ready(f"ready, {room}")
    while True:
        began_ns = next_push(hardware, supervisor.longest_wait_s)
        supervisor.alive()
        if began_ns is None:
            continue
        _show(hardware, "busy")
        try:
            press = scanner.take(lambda: _show(hardware, "may lift"))
            if held_long(hardware, began_ns):
                tell(f"Held {LONG_PUSH_S:.0f} s, no scan. {_state(hardware, scanner)}")
            else:
                outcome = scanner.publish(press, annotations)
                report(outcome)
                _show(hardware, outcome.bundle.record.verdict.level)
        except (DeviceError, HalError) as error:
            complain(error)
            _show(hardware, "refused")
        if missed := hardware.button.forget_presses():
            complain(f"{missed} push(es) came while busy and did nothing: push again when the indicator is off")
            _show(hardware, "refused")


def held_long(hardware: Hardware, began_ns: int) -> bool:
    """Whether the press that began then is held `LONG_PUSH_S`; returns when it is over or held that long."""
    held_s = (hardware.clock.monotonic_ns() - began_ns) * 1e-9
    press = hardware.button.wait_for_press(max(LONG_PUSH_S - held_s, 0.0))
    return press is None or press.held_s >= LONG_PUSH_S


def _show(hardware: Hardware, cue: Cue) -> None:
    """Play a cue; an indicator that fails never costs a scan."""
    with suppress(HalError):
        hardware.indicator.show(cue)


def _state(hardware: Hardware, scanner: Scanner) -> str:
    """Room, battery and what does not answer, in sentences."""
    reading = hardware.power.read()
    battery = "" if reading.battery_share is None else f" Battery {reading.battery_share:.0%}."
    complaints = "".join(f" {complaint}." for complaint in reading.complaints)
    return f"Room for {scanner.check_room()} scans.{battery}{complaints}"
