"""The pairing window of an instrument: open for two minutes on a thread of its own, told of as it goes."""

from __future__ import annotations

import os
import socket
import time
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

from device.errors import DeviceError, PairingRefused
from device.pairing.authorized_keys import SSHD_HOST_KEY, authorize, read_host_key
from device.pairing.window import WINDOW_S, wait_for_host
from device.pairing_exchange import CODE_DIGITS, PAIRING_PORT, DeviceCard, draw_code
from device.session.events import Failed, PairingChanged
from device.session.noticeboard import Noticeboard
from device.session.state import PairingState


@dataclass(frozen=True, slots=True)
class PairingPlace:
    """How workstations reach this instrument.

    keys : file of the workstations' keys, as sshd's configuration names it
    host_key : sshd's public key
    port, ssh_port : where the workstation's call is awaited, and where sshd listens
    user : whom sshd lets in to fetch scans
    """

    keys: Path
    host_key: Path = SSHD_HOST_KEY
    port: int = PAIRING_PORT
    ssh_port: int = 22
    user: str = "retrosync"

    @classmethod
    def beside(cls, store_root: Path) -> PairingPlace:
        """The place that the installed service uses for that store."""
        return cls(store_root.with_name(f"{store_root.name}-pairing") / "authorized_keys")


class PairingRun:
    """Opens the window once at a time."""

    def __init__(self, board: Noticeboard, place: PairingPlace, device_id: str) -> None:
        self._board = board
        self._place = place
        self._device_id = device_id
        self._thread: Thread | None = None

    def open(self, window_s: float = WINDOW_S) -> bool:
        """Open the window, and say whether it is open; what becomes of it is told by `PairingChanged`."""
        if self._thread and self._thread.is_alive():
            return True
        place = self._place
        try:
            host_key = read_host_key(place.host_key)
            listening = _listen(place.port)
        except DeviceError as error:
            self._board.change(sentence=str(error))
            self._board.tell(Failed(str(error)))
            return False
        card = DeviceCard(device_id=self._device_id, user=place.user, port=place.ssh_port, host_key=host_key)
        code, half = draw_code(), CODE_DIGITS // 2
        sentence = f"Code {code[:half]} {code[half:]}. On the workstation: retrosync pair {os.uname().nodename}"
        self._tell(PairingState(code, time.monotonic_ns() + round(window_s * 1e9), sentence, is_open=True))
        self._thread = Thread(target=self._wait, args=(listening, code, card, window_s), daemon=True, name="pairing")
        self._thread.start()
        return True

    def _wait(self, listening: socket.socket, code: str, card: DeviceCard, window_s: float) -> None:
        try:
            host = wait_for_host(listening, code, card, lambda host: authorize(self._place.keys, host), window_s)
            sentence = f"Paired with {host.name}."
        except DeviceError as error:
            sentence = str(error)
        self._tell(PairingState("", 0, sentence, is_open=False))

    def _tell(self, state: PairingState) -> None:
        self._board.change(pairing=state)
        self._board.tell(PairingChanged(state.sentence, state.is_open))


def _listen(port: int) -> socket.socket:
    try:
        return socket.create_server(("", port))
    except (OSError, OverflowError) as error:
        raise PairingRefused(f"port {port}: cannot be listened on ({error}): close the other window") from error
