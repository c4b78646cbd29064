"""From what was named to an open source: a folder when there is one of that name, else a paired device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec

from host_sync.errors import HostError, NoSource
from host_sync.offload.directory import DirectorySource
from host_sync.offload.paired_devices import PairedDevice, PairedDevices
from host_sync.offload.source import Source


@dataclass(frozen=True, slots=True)
class Address:
    """Where a device is to be sought instead of where it was last: host and, when given, port."""

    host: str
    port: int | None

    @classmethod
    def parse(cls, text: str) -> Address:
        """From "host" or "host:port"."""
        host, colon, port = text.rpartition(":") if text.count(":") == 1 else (text, "", "")
        if not host or (colon and not port.isdecimal()):
            raise HostError(f"{text!r} is no address: write HOST or HOST:PORT")
        return cls(host, int(port) if port else None)


def is_folder(name: str) -> bool:
    """Whether a source that was named is a folder, there or not, rather than a paired device.

    Raises
    ------
    NoSource
        Nothing was named.
    """
    if not name:
        raise NoSource("an empty name is no source: name a folder or a paired device")
    return "/" in name or Path(name).exists()


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
def open_device(device: PairedDevice, devices: PairedDevices, at: Address | None = None) -> Iterator[Source]:
    """A paired device as a source. Errors as for `open_source`."""
    from host_sync.offload.pairing import new_private_key
    from host_sync.offload.sftp import SftpSource
    from host_sync.offload.sftp_link import Patience, SftpLink

    if at is not None:
        device = msgspec.structs.replace(device, host=at.host, port=at.port or device.port)
    with SftpLink(device, devices.private_key(new_private_key), Patience()) as link:
        yield SftpSource(link)
