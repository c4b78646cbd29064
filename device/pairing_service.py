"""The pairing window: for two minutes a workstation may call, and a person confirms its code; then nothing listens."""

from __future__ import annotations

import os
import select
import socket
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final

import msgspec

from device.errors import DeviceError, PairingRefused, RecordError, StoreError
from device.io.atomic import replace_file
from device.io.system import explain_os_error
from device.pairing import (
    PAIRING_PORT,
    Accepted,
    Answer,
    Call,
    DeviceCard,
    HostCard,
    Opening,
    PairingChannel,
    code_of,
    draw_number,
    fingerprint_of,
    opens,
)
from device.store.store import BundleStore
from hal.interfaces import Clock
from hal.validation import explain_validation

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

    Its threads let a screen or a button's loop only poll it. Several callers are served at once, silent ones make room.
    One code is shown at a time; the third that nobody confirms closes the window.

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


# Keys of the workstations that may fetch scans: one line each, as sshd reads it.
SSHD_HOST_KEY: Final = Path("/etc/ssh/ssh_host_ed25519_key.pub")
_SECRET: Final = 0o600
_RESTRICTED: Final = "restrict"
"""No terminal, no forwarding, no user rc; sshd's configuration limits the key to SFTP."""


def authorize(path: Path, host: HostCard) -> None:
    """Add a workstation's key; a known one is kept as it is.

    Raises
    ------
    StoreError
        The file cannot be written; it is unchanged.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        before = path.read_text(encoding="utf-8") if path.exists() else ""
        if host.public_key not in before:
            line = f"{_RESTRICTED} {host.public_key} {host.name}\n"
            replace_file(path, (before + line).encode(), _SECRET)
    except (OSError, UnicodeDecodeError) as error:
        reason = explain_os_error(error) if isinstance(error, OSError) else "(no text): remove it"
        raise StoreError(f"{path}: the workstation's key cannot be stored {reason}") from error


def has_keys(path: Path) -> bool:
    """Return whether any workstation was ever paired: the file of keys is there and not empty."""
    try:
        return path.stat().st_size > 0
    except FileNotFoundError:
        return False
    except OSError as error:
        raise StoreError(f"{path}: the workstations' keys cannot be read {explain_os_error(error)}") from error


def read_host_key(path: Path) -> str:
    """sshd's public key: type and key without the comment.

    Raises
    ------
    RecordError
        The file does not exist.
    """
    try:
        words = path.read_text(encoding="ascii").split()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordError(f"{path}: sshd's public key cannot be read: install openssh-server, or name it") from error
    if len(words) < 2:
        raise RecordError(f"{path}: holds no public key: run `ssh-keygen -A`, or name another file")
    return " ".join(words[:2])


OFFLOAD_USER: Final = "retrosync"


@dataclass(frozen=True, slots=True)
class PairingSetup:
    """Set-up of this device for offload; the defaults are those of `docs/offload.md`.

    port : of the pairing window
    ssh_port, host_key : of sshd
    user : account that workstations log in to
    keys : folder of the workstations' keys; beside the store when None
    """

    port: int = PAIRING_PORT
    ssh_port: int = 22
    user: str = OFFLOAD_USER
    host_key: Path = SSHD_HOST_KEY
    keys: Path | None = None

    def authorized_keys(self, store: BundleStore) -> Path:
        """Return the file of the keys that sshd accepts."""
        return (self.keys or store.root.with_name(f"{store.root.name}-pairing")) / "authorized_keys"

    def card(self, store: BundleStore) -> DeviceCard:
        """This device's card.

        Raises
        ------
        RecordError
            sshd's key cannot be read, or user or port are invalid.
        """
        facts = {
            "schema": DeviceCard.__struct_config__.tag,
            "device_id": store.device_id,
            "user": self.user,
            "port": self.ssh_port,
            "host_key": read_host_key(self.host_key),
        }
        try:
            return msgspec.convert(facts, DeviceCard)
        except msgspec.ValidationError as error:
            raise RecordError(f"this device cannot be paired as {explain_validation(error)}: name another") from error


def open_pairing_window(
    store: BundleStore, clock: Clock, setup: PairingSetup | None = None, window_s: float = WINDOW_S
) -> PairingWindow:
    """Open the window; show the codes of its callers, and close it when the screen is left.

    Raises
    ------
    PairingRefused
        Its port is taken.
    RecordError
        sshd's key cannot be read.
    """
    setup = setup or PairingSetup()
    card, keys = setup.card(store), setup.authorized_keys(store)
    return PairingWindow(_listening(setup.port), card, lambda host: authorize(keys, host), clock, window_s)


def how_to_call(window: PairingWindow, setup: PairingSetup, store: BundleStore) -> str:
    """Return lines for a screen: the command for the workstation, and the device's id and key."""
    port = "" if setup.port == PAIRING_PORT else f" --port {setup.port}"
    return (
        f"Pairing is open for {window.seconds_left:.0f} s.\n"
        f"On the workstation: retrosync pair {os.uname().nodename}.local{port}\n"
        f"This device: {store.device_id}, key {fingerprint_of(setup.card(store).host_key)}"
    )


def describe_code(shown: ShownCode, how_to_confirm: str) -> str:
    """Return the line for a screen that shows a code."""
    return f"Code {shown.code} for {shown.host.name}: if it shows the same code, {how_to_confirm}."


def _listening(port: int) -> socket.socket:
    with suppress(OSError, OverflowError):  # without IPv6, listen on IPv4 alone
        return socket.create_server(("", port), family=socket.AF_INET6, dualstack_ipv6=True)
    try:
        return socket.create_server(("", port))
    except (OSError, OverflowError) as error:
        raise PairingRefused(f"port {port}: is not free ({error}): choose another") from error
