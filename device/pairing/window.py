"""The pairing window: for two minutes, and three wrong codes at most, a workstation may come; then nothing listens."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from contextlib import closing
from typing import Final

from device.errors import PairingRefused, RecordError
from device.pairing_channel import PairingChannel
from device.pairing_exchange import DeviceCard, Element, Exchange, HostCard

WINDOW_S: Final = 120.0
MOST_TRIES: Final = 3
CONVERSATION_S: Final = 10.0


def wait_for_host(
    listening: socket.socket,
    code: str,
    card: DeviceCard,
    authorize: Callable[[HostCard], None],
    window_s: float = WINDOW_S,
) -> HostCard:
    """The workstation that showed the code and whose key is authorized now; `listening` is closed at the end.

    Raises
    ------
    PairingRefused
        None came in time, or the code was wrong too often.
    StoreError
        Its key cannot be stored.
    """
    end_s, tries = time.monotonic() + window_s, 0
    with closing(listening):
        while tries < MOST_TRIES:
            listening.settimeout(max(end_s - time.monotonic(), 0.001))
            try:
                connection, _ = listening.accept()
            except TimeoutError as error:
                raise PairingRefused(f"no workstation came within {window_s:.0f} s: open the window again") from error
            with closing(connection):
                channel = PairingChannel(connection, min(CONVERSATION_S, max(end_s - time.monotonic(), 0.001)))
                exchange = Exchange(code, "device")
                try:
                    host = _meet(channel, exchange)
                except RecordError:
                    continue
                if exchange.is_proven(host):
                    authorize(host)
                    channel.send(exchange.proven(card))
                    return host
                tries += 1
    raise PairingRefused(f"the code was wrong {MOST_TRIES} times, and the window is closed: open it again")


def _meet(channel: PairingChannel, exchange: Exchange) -> HostCard:
    exchange.meet(channel.receive(Element))
    channel.send(exchange.element)
    return channel.receive(HostCard)
