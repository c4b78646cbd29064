"""What the service manager hears of an instrument, turn by turn: ready, alive, and how things stand.

Ready means that frames come. An instrument with a part that does not answer keeps trying, and after `PATIENCE_S` it is
ready too, with a status that begins with "out of order". Why: somebody in the field must see on screen and indicator
what is wrong, hear of it over SSH and fetch the scans; a start that failed would be ended and begun anew again and
again, with a dark screen. Nobody takes such a start for a working one: the status says so, and an update that starts so
is not kept (`board/retrograph-slot confirm`).
"""

from __future__ import annotations

from typing import Final

from device.scanning.supervision import Supervisor
from device.session.state import InstrumentState
from hal.interfaces import Clock

PATIENCE_S: Final = 10.0
"""For a bus or a camera that comes up later than the program."""

BROKEN: Final = "out of order"


class ServiceReport:
    """Tells a service manager of one instrument.

    Parameters
    ----------
    supervisor : who is told
    clock : the instrument's
    """

    def __init__(self, supervisor: Supervisor, clock: Clock) -> None:
        self._supervisor = supervisor
        self._clock = clock
        self._began_ns = clock.monotonic_ns()
        self._is_ready = False
        self._told = ""

    def turn(self, state: InstrumentState) -> None:
        """A turn of the work loop was done, and left the instrument in this state."""
        now = status_line(state)
        if not self._is_ready and (state.activity != BROKEN or self._waited_s() >= PATIENCE_S):
            self._is_ready = True
            self._supervisor.ready(now)
        elif now != self._told:
            self._supervisor.status(now)
        self._told = now
        self._supervisor.alive()

    def ended(self) -> None:
        """The work loop has ended."""
        self._supervisor.stopping()

    def _waited_s(self) -> float:
        return (self._clock.monotonic_ns() - self._began_ns) * 1e-9


def status_line(state: InstrumentState) -> str:
    """How an instrument stands, in one line; one that cannot scan says so first."""
    if state.activity == BROKEN:
        return f"{BROKEN}: {state.sentence}"
    if state.calibration.fault:
        return f"no scans yet: {state.calibration.fault}"
    return "ready" if state.scans_left is None else f"ready: room for {state.scans_left} scans"
