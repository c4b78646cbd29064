"""Records over a socket, one JSON line each, with an end in time and size: both sides of pairing speak through it."""

from __future__ import annotations

import socket
import time
from typing import TypeVar

import msgspec

from device.errors import RecordError
from device.pairing_exchange import MOST_MESSAGE_BYTES
from device.records import Record, decode_record

RecordT = TypeVar("RecordT", bound=Record)


class PairingChannel:
    """One connection; every method raises `RecordError` when the other side is gone, slow or talks nonsense.

    Parameters
    ----------
    connection : closed by the caller
    within_s : how long the whole conversation may take
    """

    def __init__(self, connection: socket.socket, within_s: float) -> None:
        self._connection = connection
        self._end_s = time.monotonic() + within_s
        self._unread = b""

    def send(self, record: Record) -> None:
        """Send one record."""
        try:
            self._connection.settimeout(self._left_s())
            self._connection.sendall(msgspec.json.encode(record) + b"\n")
        except OSError as error:
            raise RecordError(f"pairing: the other side has gone ({error}): begin again") from error

    def receive(self, kind: type[RecordT]) -> RecordT:
        """The next record, of that kind."""
        while b"\n" not in self._unread:
            try:
                self._connection.settimeout(self._left_s())
                some = self._connection.recv(MOST_MESSAGE_BYTES)
            except OSError as error:
                raise RecordError(f"pairing: the other side is silent ({error}): begin again") from error
            self._unread += some
            if not some or len(self._unread) > MOST_MESSAGE_BYTES:
                raise RecordError("pairing: the other side hung up: begin again")
        line, _, self._unread = self._unread.partition(b"\n")
        return decode_record(line, kind, "pairing", "begin again")

    def _left_s(self) -> float:
        left_s = self._end_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError("too slow")
        return left_s
