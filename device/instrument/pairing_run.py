"""Pairing on the instrument: the window, polled by the worker, and the network facts that a workstation needs."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from device.errors import DeviceError, RecordError
from device.instrument.events import Failed, PairingChanged
from device.instrument.state import PairingState, StateStore
from device.pairing import fingerprint_of
from device.pairing_service import (
    PairingSetup,
    PairingWindow,
    describe_code,
    has_keys,
    how_to_call,
    open_pairing_window,
    read_host_key,
)
from device.store.store import BundleStore
from hal.interfaces import Clock

HOW_TO_CONFIRM: Final = "hold the button for 2 s"


class PairingRun:
    """Opens at most one window at a time."""

    def __init__(self, states: StateStore, store: BundleStore, clock: Clock, setup: PairingSetup) -> None:
        self._states = states
        self._store = store
        self._clock = clock
        self._setup = setup
        self._window: PairingWindow | None = None
        self._how_to_call = self._code = ""

    def open(self) -> bool:
        """Open the window, or confirm the code that it shows; returns whether it has just been opened.

        `PairingChanged` reports each code and the outcome.
        """
        if self._window:
            self._window.confirm(self._code)
            return False
        try:
            window = open_pairing_window(self._store, self._clock, self._setup)
            self._how_to_call = how_to_call(window, self._setup, self._store)
        except DeviceError as error:
            self._states.update(sentence=str(error))
            self._states.publish(Failed(str(error)))
            return False
        self._window = window
        self._report_window(window)
        return True

    def open_when_new(self) -> bool:
        """Open the window of a device that was never paired; returns whether it has just been opened."""
        return not self._window and not has_keys(self._setup.authorized_keys(self._store)) and self.open()

    @property
    def shows_code(self) -> bool:
        """True while a code waits for its confirmation."""
        return bool(self._code)

    def step(self) -> None:
        """Report a new code, a paired workstation, or the end of the time."""
        if self._window is None:
            return
        if outcome := self._window.outcome:
            self._window, self._code = None, ""
            self._report(PairingState("", 0, outcome.sentence, is_open=False))
        elif (self._window.shown.code if self._window.shown else "") != self._code:
            self._report_window(self._window)

    def close(self) -> None:
        """Close the window."""
        if self._window:
            self._window.close()
            self.step()

    def _report_window(self, window: PairingWindow) -> None:
        shown = window.shown
        self._code = shown.code if shown else ""
        sentence = describe_code(shown, HOW_TO_CONFIRM) if shown else self._how_to_call
        until_ns = self._clock.monotonic_ns() + round(window.seconds_left * 1e9)
        self._report(PairingState(self._code, until_ns, sentence, is_open=True))

    def _report(self, state: PairingState) -> None:
        self._states.update(pairing=state)
        self._states.publish(PairingChanged(state.sentence, state.is_open))


@dataclass(frozen=True, slots=True)
class NetworkInfo:
    """Address to type on the workstation, and fingerprint to compare.

    addresses : IPv4, of cable and Wi-Fi; empty without a network
    key_fingerprint : of sshd's key as OpenSSH prints it, or why it cannot be read
    """

    host_name: str
    addresses: tuple[str, ...]
    key_fingerprint: str


def network_info(host_key: Path) -> NetworkInfo:
    """Return the network state now."""
    return NetworkInfo(os.uname().nodename, _addresses(), _fingerprint(host_key))


def _addresses() -> tuple[str, ...]:
    """Return addresses that other machines may reach; the kernel gives the source address of a route to each target."""
    found = []
    for target in ("192.0.2.1", "10.55.0.1", "169.254.1.1"):
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.connect((target, 9))  # connecting a datagram socket sends nothing
                address = str(probe.getsockname()[0])
        except OSError:
            continue
        if address not in found and not address.startswith("127."):
            found.append(address)
    return tuple(found)


def _fingerprint(host_key: Path) -> str:
    try:
        return fingerprint_of(read_host_key(host_key))
    except (RecordError, ValueError) as error:
        return str(error)
