"""What others need to find and to recognise this machine: its name, its addresses, its key's fingerprint."""

from __future__ import annotations

import base64
import binascii
import fcntl
import hashlib
import socket
import struct
from contextlib import suppress
from pathlib import Path
from typing import Final

from device.errors import RecordError
from device.pairing.authorized_keys import read_host_key

_SIOCGIFADDR: Final = 0x8915
_LOOPBACK: Final = "lo"


def host_name() -> str:
    """The name under which the machine is found on a network."""
    return socket.gethostname()


def addresses() -> list[tuple[str, str]]:
    """Interfaces that have an IPv4 address, and the address; loopback left out."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            if name == _LOOPBACK:
                continue
            with suppress(OSError):
                request = struct.pack("256s", name.encode()[:15])
                answer = fcntl.ioctl(asked.fileno(), _SIOCGIFADDR, request)
                found.append((name, socket.inet_ntoa(answer[20:24])))
    return found


def key_fingerprint(public_key: Path) -> str:
    """The fingerprint of sshd's key as `ssh` shows it, or the sentence that says why there is none."""
    try:
        key = base64.b64decode(read_host_key(public_key).split()[1], validate=True)
    except RecordError as error:
        return str(error)
    except binascii.Error:
        return f"{public_key}: holds no public key: run `ssh-keygen -A`"
    return "SHA256:" + base64.b64encode(hashlib.sha256(key).digest()).decode().rstrip("=")
