"""The pairing window of an instrument: opened by a long push or the screen, looked after by the loop, told of."""

from __future__ import annotations

from device.bundle_store import BundleStore
from device.errors import DeviceError
from device.pairing.opening import PairingSetup, how_to_call, open_pairing_window
from device.pairing.window import PairingWindow
from device.session.events import Failed, PairingChanged
from device.session.noticeboard import Noticeboard
from device.session.state import PairingState
from hal.interfaces import Clock


class PairingRun:
    """Opens the window once at a time."""

    def __init__(self, board: Noticeboard, store: BundleStore, clock: Clock, setup: PairingSetup) -> None:
        self._board = board
        self._store = store
        self._clock = clock
        self._setup = setup
        self._window: PairingWindow | None = None

    def open(self) -> bool:
        """Open the window, and say whether it is open; what becomes of it is told by `PairingChanged`."""
        if self._window:
            return True
        try:
            window = open_pairing_window(self._store, self._clock, self._setup)
            sentence = how_to_call(window, self._setup, self._store)
        except DeviceError as error:
            self._board.change(sentence=str(error))
            self._board.tell(Failed(str(error)))
            return False
        self._window = window
        until_ns = self._clock.monotonic_ns() + round(window.seconds_left * 1e9)
        self._tell(PairingState(window.code, until_ns, sentence, is_open=True))
        return True

    def step(self) -> None:
        """See whether somebody came, or the time is over."""
        if self._window and (outcome := self._window.outcome):
            self._window = None
            self._tell(PairingState("", 0, outcome.sentence, is_open=False))

    def close(self) -> None:
        """Nothing listens any more."""
        if self._window:
            self._window.close()
            self.step()

    def _tell(self, state: PairingState) -> None:
        self._board.change(pairing=state)
        self._board.tell(PairingChanged(state.sentence, state.is_open))
