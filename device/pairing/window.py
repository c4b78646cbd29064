"""The pairing window: for two minutes, and three wrong codes at most, a workstation may come; then nothing listens.

It works in a thread of its own, so that a screen or a button's loop only has to look at it now and then.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from types import TracebackType
from typing import Final

from device.errors import DeviceError, PairingRefused, RecordError
from device.pairing_channel import PairingChannel
from device.pairing_exchange import CODE_DIGITS, DeviceCard, Element, Exchange, HostCard, draw_code
from hal.interfaces import Clock

WINDOW_S: Final = 120.0
MOST_TRIES: Final = 3
CONVERSATION_S: Final = 10.0
_LOOK_S: Final = 0.1
"""How often the thread looks whether the time is over."""


@dataclass(frozen=True, slots=True)
class PairingOutcome:
    """How a window ended: the workstation that was let in, or None; and a sentence for the screen."""

    host: HostCard | None
    sentence: str


class PairingWindow:
    """An open window; a context manager that closes it, and after which nothing listens.

    Parameters
    ----------
    listening : where a workstation calls; the window closes it
    card : what the device shows to who knows the code
    authorize : lets a workstation in
    clock : counts the two minutes
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
        """How long a workstation may still come, s; 0 when the window is closed."""
        if self._ended is not None:
            return 0.0
        return max(self._end_ns - self._clock.monotonic_ns(), 0) / 1e9

    @property
    def outcome(self) -> PairingOutcome | None:
        """How it ended; None while it is open."""
        if self._ended is None and self.seconds_left <= 0.0:
            self._end(PairingOutcome(None, "no workstation came in time, and the window is closed: open it again"))
        return self._ended

    def wait(self) -> HostCard:
        """The workstation that was let in.

        Raises
        ------
        PairingRefused
            None was: the outcome's sentence.
        """
        self._thread.join()
        outcome = self.outcome
        if outcome is None or outcome.host is None:
            raise PairingRefused(outcome.sentence if outcome else "the window is closed: open it again")
        return outcome.host

    def close(self) -> None:
        """Close the window before its time; one that has ended keeps its outcome."""
        self._end(PairingOutcome(None, "the window was closed: open it again"))
        self._thread.join()

    def _listen(self) -> None:
        tries = 0
        with closing(self._listening):
            while self.outcome is None:
                if not select.select([self._listening], [], [], _LOOK_S)[0]:
                    continue
                connection, _ = self._listening.accept()
                with closing(connection):
                    tries += self._converse(connection)
                if tries >= MOST_TRIES:
                    sentence = f"the code was wrong {tries} times, and the window is closed: open it again"
                    self._end(PairingOutcome(None, sentence))

    def _converse(self, connection: socket.socket) -> bool:
        """Whether who called did not know the code; who does is let in, and who talks nonsense has not tried."""
        channel, exchange = PairingChannel(connection, CONVERSATION_S), Exchange(self.code, "device")
        try:
            exchange.meet(channel.receive(Element))
            channel.send(exchange.element)
            host = channel.receive(HostCard)
        except RecordError:
            return False
        if not exchange.is_proven(host):
            return True
        with self._ending:
            if self._ended is None and self._end_ns > self._clock.monotonic_ns():
                self._ended = self._let_in(host, channel, exchange.proven(self._card))
        return False

    def _let_in(self, host: HostCard, channel: PairingChannel, card: HostCard | DeviceCard) -> PairingOutcome:
        try:
            self._authorize(host)
        except DeviceError as error:
            return PairingOutcome(None, str(error))
        try:
            channel.send(card)
        except RecordError:
            return PairingOutcome(
                None, f"{host.name} went away before it took this device's key: open the window again"
            )
        return PairingOutcome(host, f"paired with {host.name}")

    def _end(self, outcome: PairingOutcome) -> None:
        with self._ending:
            self._ended = self._ended or outcome
