"""Records over a socket, one JSON line each, limited in time and size: the channel of both sides of pairing."""

from __future__ import annotations

import socket
import time
from typing import TypeVar

import msgspec

from device.bundles.record import Record, decode_record
from device.errors import RecordError
from device.pairing.exchange import MAX_MESSAGE_BYTES

RecordT = TypeVar("RecordT", bound=Record)


class PairingChannel:
    """One connection; every method raises `RecordError` when the other side is gone, slow or sends something else.

    Parameters
    ----------
    connection : closed by the caller
    within_s : time limit of the whole conversation, s
    """

    def __init__(self, connection: socket.socket, within_s: float) -> None:
        self._connection = connection
        self._unread = b""
        self.limit(within_s)

    def limit(self, within_s: float) -> None:
        """Give the rest of the conversation a new time limit, s."""
        self._end_s = time.monotonic() + within_s

    def send(self, record: Record) -> None:
        """Send one record."""
        try:
            self._connection.settimeout(self._left_s())
            self._connection.sendall(msgspec.json.encode(record) + b"\n")
        except OSError as error:
            raise RecordError(f"pairing: the other side is gone ({error}): start again") from error

    def receive(self, kind: type[RecordT]) -> RecordT:
        """The next record, which must be of that kind."""
        while b"\n" not in self._unread:
            try:
                self._connection.settimeout(self._left_s())
                some = self._connection.recv(MAX_MESSAGE_BYTES)
            except OSError as error:
                raise RecordError(f"pairing: the other side is silent ({error}): start again") from error
            self._unread += some
            if not some or len(self._unread) > MAX_MESSAGE_BYTES:
                raise RecordError("pairing: the other side closed the connection: start again")
        line, _, self._unread = self._unread.partition(b"\n")
        return decode_record(line, kind, "pairing", "start again")

    def _left_s(self) -> float:
        left_s = self._end_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError("too slow")
        return left_s
