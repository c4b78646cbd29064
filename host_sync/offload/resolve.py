"""Opening the source that the user named: a folder of that name if there is one, else a paired device."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from host_sync.errors import HostError, NoSource
from host_sync.offload.paired_devices import PairedDevice, PairedDevices
from host_sync.offload.source import PATIENCE_S, DirectorySource, Source

MAX_PORT: Final = 65535


@dataclass(frozen=True, slots=True)
class Address:
    """An address that overrides a device's stored one: host and, when given, port."""

    host: str
    port: int | None

    @classmethod
    def parse(cls, text: str) -> Address:
        """From "host", "host:port", "[address of IPv6]:port" or the bare address."""
        found = re.fullmatch(r"\[(?P<v6>[^]]+)\](:(?P<v6_port>\d+))?|(?P<host>[^][:]+)(:(?P<port>\d+))?", text)
        if found is None and text.count(":") > 1 and "[" not in text:
            return cls(text, None)
        host, port = (found["v6"] or found["host"], found["v6_port"] or found["port"]) if found else (None, None)
        if host is None or not 1 <= int(port or 1) <= MAX_PORT:
            raise HostError(f"{text!r} is no address: give HOST or HOST:PORT")
        return cls(host, int(port) if port else None)


def is_folder(name: str) -> bool:
    """Return whether the user named a folder, existing or not, rather than a paired device.

    Raises
    ------
    NoSource
        The name is empty.
    """
    if not name:
        raise NoSource("the source has no name: name a folder or a paired device")
    try:
        return "/" in name or Path(name).exists()
    except OSError:  # too long for a file's name
        return False


@contextmanager
def open_source(name: str, devices: PairedDevices, at: Address | None = None) -> Iterator[Source]:
    """A source to pull from.

    Raises
    ------
    NoSource
        It is neither a folder with scans nor a paired device.
    SourceLost, SourceRefused
        The device cannot be reached, or is another.
    """
    if is_folder(name):
        yield DirectorySource(Path(name))
        return
    with open_device(devices.find(name), devices, at) as source:
        yield source


@contextmanager
def open_device(
    device: PairedDevice, devices: PairedDevices, at: Address | None = None, patience_s: float = PATIENCE_S
) -> Iterator[Source]:
    """A paired device as a source; without data it is given up after `patience_s`. Errors as for `open_source`."""
    from host_sync.offload.paired_devices import new_private_key
    from host_sync.offload.sftp import SftpSource
    from host_sync.offload.sftp_link import ReconnectingSftp, Timeouts

    if at is not None:
        device = msgspec.structs.replace(device, host=at.host, port=at.port or device.port)
    timeouts = Timeouts.of_patience(patience_s)
    with ReconnectingSftp(device, devices.private_key(new_private_key), timeouts) as link:
        yield SftpSource(link)
