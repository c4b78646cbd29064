"""Opening this device's pairing window, for a screen, the button or a command."""

from __future__ import annotations

import base64
import hashlib
import os
import socket
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from device.errors import PairingRefused, RecordError, StoreError
from device.io.atomic import replace_file
from device.io.system import explain_os_error
from device.pairing import PAIRING_PORT, DeviceCard, HostCard
from device.pairing_service.window import WINDOW_S, PairingWindow, ShownCode
from device.store.store import BundleStore
from hal.interfaces import Clock
from hal.validation import explain_validation

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


def fingerprint_of(public_key: str) -> str:
    """Return a key's fingerprint as OpenSSH shows it, such as "SHA256:mVPwvezndPv/ARoIadVY98vAC0g"."""
    digest = hashlib.sha256(base64.b64decode(public_key.split()[1])).digest()
    return "SHA256:" + base64.b64encode(digest).decode().rstrip("=")


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
