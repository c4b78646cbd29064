"""The pairing window: a workstation may pair for two minutes, until three wrong codes; then nothing listens.

It runs in threads of its own, so that a screen or a button's loop only polls it. Several callers are served at once,
and silent ones make room: a caller that only connects cannot keep the right code out.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Final

from device.errors import DeviceError, PairingRefused, RecordError
from device.pairing.channel import PairingChannel
from device.pairing.exchange import CODE_DIGITS, Confirmation, DeviceCard, Exchange, HostCard, Share, draw_code
from hal.interfaces import Clock

WINDOW_S: Final = 120.0
MAX_TRIES: Final = 3
MAX_CALLERS: Final = 16
MAX_PER_ADDRESS: Final = 4
CONVERSATION_S: Final = 10.0
_POLL_S: Final = 0.1
"""Interval at which the thread checks whether the time is over."""


@dataclass(frozen=True, slots=True)
class PairingOutcome:
    """Outcome of a window: the paired workstation, or None; and a sentence for the screen."""

    host: HostCard | None
    sentence: str


@dataclass(slots=True, eq=False)
class _Call:
    """A connection from an address, and whether its first message has arrived."""

    connection: socket.socket
    address: str
    heard: bool = False

    def hang_up(self) -> None:
        """End the conversation; the thread that serves it notices and closes the connection."""
        with suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)


class PairingWindow:
    """An open window; a context manager that closes it, so that nothing listens afterwards.

    Parameters
    ----------
    listening : socket for workstations; the window closes it
    card : the device's
    authorize : installs a workstation's key
    clock : measures the two minutes
    """

    def __init__(
        self,
        listening: socket.socket,
        card: DeviceCard,
        authorize: Callable[[HostCard], None],
        clock: Clock,
        window_s: float = WINDOW_S,
    ) -> None:
        self.code = draw_code()
        self._listening = listening
        self._card = card
        self._authorize = authorize
        self._clock = clock
        self._end_ns = clock.monotonic_ns() + round(window_s * 1e9)
        self._ending = threading.Lock()
        self._calling = threading.Lock()
        self._calls: list[_Call] = []
        self._tries = 0
        self._ended: PairingOutcome | None = None
        self._thread = threading.Thread(target=self._listen, name="pairing", daemon=True)
        self._thread.start()

    def __enter__(self) -> PairingWindow:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def code_to_show(self) -> str:
        """The code in two halves, as people read it."""
        half = CODE_DIGITS // 2
        return f"{self.code[:half]} {self.code[half:]}"

    @property
    def seconds_left(self) -> float:
        """Time left, s; 0 when the window is closed."""
        if self._ended is not None:
            return 0.0
        return max(self._end_ns - self._clock.monotonic_ns(), 0) / 1e9

    @property
    def outcome(self) -> PairingOutcome | None:
        """Outcome; None while it is open."""
        if self._ended is None and self.seconds_left <= 0.0:
            self._end(PairingOutcome(None, "no workstation came in time, and the window is closed: open it again"))
        return self._ended

    def wait(self) -> HostCard:
        """Wait for the outcome; returns the paired workstation.

        Raises
        ------
        PairingRefused
            No workstation was paired: the outcome's sentence.
        """
        self._thread.join()
        outcome = self.outcome
        if outcome is None or outcome.host is None:
            raise PairingRefused(outcome.sentence if outcome else "the window is closed: open it again")
        return outcome.host

    def close(self) -> None:
        """Close the window early; one that has ended keeps its outcome."""
        self._end(PairingOutcome(None, "the window was closed: open it again"))
        self._thread.join()

    def _listen(self) -> None:
        with closing(self._listening), ThreadPoolExecutor(2 * MAX_CALLERS, "pairing") as conversations:
            while self.outcome is None:
                if select.select([self._listening], [], [], _POLL_S)[0]:
                    connection, address = self._listening.accept()
                    call = _Call(connection, str(address[0]))
                    if self._admit(call):
                        conversations.submit(self._serve, call)
                    else:
                        connection.close()
            with self._calling:
                for call in self._calls:
                    call.hang_up()

    def _admit(self, call: _Call) -> bool:
        """Return whether there is room for a caller; callers that have said nothing yet make room, the oldest first."""
        with self._calling:
            same = [one for one in self._calls if one.address == call.address]
            for crowd, limit in ((same, MAX_PER_ADDRESS), (self._calls, MAX_CALLERS)):
                if len(crowd) >= limit:
                    silent = next((one for one in crowd if not one.heard), None)
                    if silent is None:
                        return False
                    self._calls.remove(silent)
                    silent.hang_up()
            self._calls.append(call)
        return True

    def _serve(self, call: _Call) -> None:
        with closing(call.connection):
            self._converse(call)
        with self._calling, suppress(ValueError):
            self._calls.remove(call)

    def _converse(self, call: _Call) -> None:
        """Let the caller in if it knows the code; a wrong code counts, anything else does not."""
        channel, exchange = PairingChannel(call.connection, CONVERSATION_S), Exchange(self.code, self._card)
        try:
            host = exchange.meet(channel.receive(Share), HostCard)
            call.heard = True
            channel.send(exchange.share)
            confirmation = channel.receive(Confirmation)
        except RecordError:
            return
        with self._ending:  # one at a time: no more than the allowed guesses are ever compared
            if self._ended is not None or self._end_ns <= self._clock.monotonic_ns():
                return
            if exchange.is_confirmed(confirmation):
                self._ended = self._let_in(host, channel, exchange.confirmation)
                return
            self._tries += 1
            if self._tries >= MAX_TRIES:
                sentence = f"the code was wrong {self._tries} times, and the window is closed: open it again"
                self._ended = PairingOutcome(None, sentence)

    def _let_in(self, host: HostCard, channel: PairingChannel, proof: Confirmation) -> PairingOutcome:
        try:
            self._authorize(host)
        except DeviceError as error:
            return PairingOutcome(None, str(error))
        try:
            channel.send(proof)
        except RecordError:
            return PairingOutcome(
                None, f"{host.name} disconnected before it had this device's proof: open the window again"
            )
        return PairingOutcome(host, f"paired with {host.name}")

    def _end(self, outcome: PairingOutcome) -> None:
        with self._ending:
            self._ended = self._ended or outcome
