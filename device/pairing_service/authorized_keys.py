"""Keys of the workstations that may fetch scans: one line each, as sshd reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from device.errors import RecordError, StoreError
from device.io.atomic import replace_file
from device.io.os_errors import explain_os_error
from device.pairing.exchange import HostCard

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
