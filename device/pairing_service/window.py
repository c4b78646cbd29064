"""The pairing window: for two minutes a workstation may call, and a person confirms its code; then nothing listens.

It runs in threads of its own, so that a screen or a button's loop only polls it. Several callers are served at once,
and silent ones make room: a caller that only connects keeps nobody out. One code is shown at a time, and the third one
that nobody confirms closes the window.
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
from device.pairing import (
    Accepted,
    Answer,
    Call,
    DeviceCard,
    HostCard,
    Opening,
    PairingChannel,
    code_of,
    draw_number,
    opens,
)
from hal.interfaces import Clock

WINDOW_S: Final = 120.0
MAX_CODES: Final = 3
MAX_CALLERS: Final = 16
MAX_PER_ADDRESS: Final = 4
CONVERSATION_S: Final = 10.0
READING_S: Final = 1.0
"""A code is confirmed after at least this time on the screen: a push that came earlier was meant for something else."""

_POLL_S: Final = 0.1
"""Interval at which the threads check whether the time is over."""


@dataclass(frozen=True, slots=True)
class PairingOutcome:
    """Outcome of a window: the paired workstation, or None; and a sentence for the screen."""

    host: HostCard | None
    sentence: str


@dataclass(frozen=True, slots=True)
class ShownCode:
    """A code on the screen, the workstation that called, and since when it is shown (ns of the window's clock)."""

    code: str
    host: HostCard
    since_ns: int


@dataclass(slots=True, eq=False)
class _Caller:
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
        self._listening = listening
        self._card = card
        self._authorize = authorize
        self._clock = clock
        self._end_ns = clock.monotonic_ns() + round(window_s * 1e9)
        self._ending = threading.Lock()
        self._calling = threading.Lock()
        self._calls: list[_Caller] = []
        self._codes = 0
        self._shown: ShownCode | None = None
        self._confirmed = False
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
    def shown(self) -> ShownCode | None:
        """The code to show now; None while no workstation waits for its confirmation."""
        return self._shown if self.outcome is None else None

    def confirm(self, code: str) -> bool:
        """Let the workstation in whose code is that; returns False when another code, or one only now, is shown."""
        with self._ending:
            shown = self._shown
            if shown is None or shown.code != code or self._ended is not None:
                return False
            self._confirmed = self._clock.monotonic_ns() - shown.since_ns >= READING_S * 1e9
            return self._confirmed

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
                    call = _Caller(connection, str(address[0]))
                    if self._admit(call):
                        conversations.submit(self._serve, call)
                    else:
                        connection.close()
            with self._calling:
                for call in self._calls:
                    call.hang_up()

    def _admit(self, call: _Caller) -> bool:
        """Return whether there is room for a caller; callers that have said nothing yet make room, the oldest first."""
        with self._calling:
            same = [other for other in self._calls if other.address == call.address]
            for crowd, limit in ((same, MAX_PER_ADDRESS), (self._calls, MAX_CALLERS)):
                if len(crowd) >= limit:
                    silent = next((other for other in crowd if not other.heard), None)
                    if silent is None:
                        return False
                    self._calls.remove(silent)
                    silent.hang_up()
            self._calls.append(call)
        return True

    def _serve(self, call: _Caller) -> None:
        with closing(call.connection):
            self._converse(call)
        with self._calling, suppress(ValueError):
            self._calls.remove(call)

    def _converse(self, call: _Caller) -> None:
        """Exchange cards and numbers with a caller, show the code, and wait for its confirmation."""
        channel, number = PairingChannel(call.connection, CONVERSATION_S), draw_number()
        try:
            called = channel.receive(Call)
            call.heard = True
            channel.send(Answer(card=self._card, number=number))
            opening = channel.receive(Opening)
        except RecordError:
            return
        if not opens(called, opening):
            return
        if self._show(code_of(called.card, self._card, opening.number, number), called.card):
            self._await_confirmation(call.connection, channel, called.card)

    def _show(self, code: str, host: HostCard) -> bool:
        """Show a code unless another one is shown or the window is closed; returns whether it is shown."""
        with self._ending:
            free = self._shown is None and self._ended is None and self._end_ns > self._clock.monotonic_ns()
            if free:
                self._codes += 1
                self._confirmed = False
                self._shown = ShownCode(code, host, self._clock.monotonic_ns())
            return free

    def _await_confirmation(self, connection: socket.socket, channel: PairingChannel, host: HostCard) -> None:
        while self.outcome is None and not self._confirmed and not select.select([connection], [], [], _POLL_S)[0]:
            pass
        with self._ending:
            self._shown = None
            if self._ended is None and self._confirmed:
                self._ended = self._let_in(host, channel)
            elif self._ended is None and self._codes >= MAX_CODES:
                sentence = f"{self._codes} codes were shown and not confirmed, and the window is closed: open it again"
                self._ended = PairingOutcome(None, sentence)

    def _let_in(self, host: HostCard, channel: PairingChannel) -> PairingOutcome:
        try:
            self._authorize(host)
        except DeviceError as error:
            return PairingOutcome(None, str(error))
        try:
            channel.limit(CONVERSATION_S)
            channel.send(Accepted())
        except RecordError:
            return PairingOutcome(None, f"{host.name} disconnected before it was accepted: open the window again")
        return PairingOutcome(host, f"paired with {host.name}")

    def _end(self, outcome: PairingOutcome) -> None:
        with self._ending:
            self._ended = self._ended or outcome
