"""Sources of bundles: a folder, a card, or a device over the network, behind one Protocol.

A place is a path below the store with "/" between its parts, such as "scans/<id>/raw.tif". Nothing that a source
states is trusted.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, Protocol

import msgspec

from device.bundles.bundle import MANIFESTS, BundleKind, BundleNames, bundle_names
from device.bundles.record import CHUNK_BYTES
from device.io.folder import Folder, open_regular
from device.io.system import explain_os_error
from host_sync.errors import HostError, NoSource, SourceError, SourceLost
from host_sync.offload.paired_devices import PairedDevice, PairedDevices

PATIENCE_S: Final = 8.0
"""Without any data, after which a device counts as gone."""


class Source(Protocol):
    """A store whose published bundles can be read, and where receipts and calibrations can be left."""

    @property
    def name(self) -> str:
        """The source's name in messages."""
        ...

    def bundle_names(self, kind: BundleKind) -> BundleNames:
        """Return ids of the published bundles, and entries that cannot be bundles.

        Raises
        ------
        SourceError
            It cannot be read.
        """
        ...

    def names(self, folder: str) -> list[str]:
        """Return names in a folder of the store, sorted; none when there is no such folder.

        Raises
        ------
        SourceError
            It cannot be read, or is no folder.
        """
        ...

    def blocks(self, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        """Yield a file's bytes from an offset, in blocks of at most a megabyte.

        Raises
        ------
        SourceError
            There is no such regular file, or it may not be read.
        SourceLost
            The source went away; what was yielded is good.
        """
        ...

    def write(self, place: str, data: bytes | Path) -> None:
        """Put a file there in one step: these bytes, or the content of a file of ours.

        Raises
        ------
        SourceError
            The source is read-only, full or gone.
        """
        ...

    def make_folder(self, place: str) -> None:
        """Make a folder; an existing one is kept. Errors as for `write`."""
        ...

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder. Errors as for `write`."""
        ...

    def clock_offset_s(self) -> float | None:
        """Return how far the source's clock is ahead of ours, s; None when it has none or does not show it."""
        ...


# A source that is a folder: a card, a mount, or a store on this machine. Nothing below it is followed or trusted.

_USUAL_PLACES: Final = ("retroscan", "var/lib/retroscan")


class DirectorySource:
    """A store's folder, or a card or mount that contains one.

    Raises
    ------
    NoSource
        There is no store, or more than one.
    """

    def __init__(self, path: Path) -> None:
        self.root = _locate_store(path)

    @property
    def name(self) -> str:
        """The store's folder."""
        return str(self.root)

    def bundle_names(self, kind: BundleKind) -> BundleNames:
        """Return ids of the published bundles, and entries that cannot be bundles."""
        with self._refusing(kind, "be read"), Folder(self.root) as folder:
            try:
                return bundle_names(folder.entries(kind))
            except FileNotFoundError:
                return BundleNames((), ())

    def names(self, folder: str) -> list[str]:
        """Return names in a folder of the store, sorted; none when there is no such folder."""
        with self._refusing(folder, "be read"), Folder(self.root) as root:
            try:
                return [entry.name for entry in root.entries(folder)]
            except FileNotFoundError:
                return []

    def blocks(self, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        """Yield a regular file's bytes."""
        with ExitStack() as stack:
            with self._refusing(place, "be read", "fetch the bundle again"):
                folder = stack.enter_context(Folder(self.root))
                stream = stack.enter_context(folder.opened(place))
                stream.seek(offset_bytes)
            while block := self._next_block(stream, place):
                yield block

    def write(self, place: str, data: bytes | Path) -> None:
        """Put a file there, durable before it appears under its name."""
        with self._refusing(place, "be written"), Folder(self.root) as folder:
            if isinstance(data, bytes):
                folder.write(place, data)
            else:
                with os.fdopen(open_regular(data), "rb") as stream:
                    folder.write(place, stream)

    def make_folder(self, place: str) -> None:
        """Make a folder; an existing one is kept."""
        with self._refusing(place, "be made"), Folder(self.root) as folder:
            folder.make_folder(place)

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder."""
        with self._refusing(place, "be renamed"), Folder(self.root) as folder:
            folder.rename(place, new_place)

    def clock_offset_s(self) -> None:
        """Return None: a folder has no clock."""
        return

    def _next_block(self, stream: BinaryIO, place: str) -> bytes:
        with self._refusing(place, "be read"):
            return stream.read(CHUNK_BYTES)

    @contextmanager
    def _refusing(self, place: str, verb: str, remedy: str | None = None) -> Iterator[None]:
        """Turn the system's errors into a sentence; when the whole card is gone, into `SourceLost`."""
        try:
            yield
        except OSError as error:
            lost = error.errno in (errno.EIO, errno.ENODEV, errno.ENXIO, errno.ESTALE) and not self._is_there()
            reason = explain_os_error(error) if remedy is None else f"({error.strerror or error}): {remedy}"
            raise (SourceLost if lost else SourceError)(
                f"{self.root / place}: cannot {verb} {reason}{'; then repeat' if lost else ''}"
            ) from error

    def _is_there(self) -> bool:
        """Return whether the folder can still be listed.

        If so, a bad block concerns one file, else the whole card is gone.
        """
        try:
            return next(self.root.iterdir(), None) is not None
        except OSError:
            return False


def _locate_store(path: Path) -> Path:
    """Return the one store at or below a path."""
    try:
        found = _stores(path)
    except OSError as error:
        raise NoSource(f"{path}: cannot be read {explain_os_error(error)}, or name a paired device") from error
    if not found:
        raise NoSource(f"{path}: holds no scans and no calibrations: name the folder that contains `scans`")
    if len(found) > 1:
        raise NoSource(f"{path}: holds several stores, name one: {', '.join(map(str, found))}")
    return found[0]


def _stores(path: Path) -> list[Path]:
    """Return the path itself when it is a store, else the stores in the usual places and just below it."""
    if _is_store(path):
        return [path]
    with Folder(path) as folder:
        children = [entry.name for entry in folder.entries() if entry.kind == "folder"]
    places = {path / place for place in (*_USUAL_PLACES, *children)}
    return sorted(place for place in places if _is_store(place))


def _is_store(path: Path) -> bool:
    """Return whether a folder of bundles is there; links below the path the user named are not followed."""
    for kind in MANIFESTS:
        with suppress(OSError), Folder(path) as folder:
            folder.entries(kind)
            return True
    return False


# Opening the source that the user named: a folder of that name if there is one, else a paired device.

MAX_PORT: Final = 65535


@dataclass(frozen=True, slots=True)
class Address:
    """An address that overrides a device's stored one: host and, when given, port."""

    host: str
    port: int | None

    @classmethod
    def parse(cls, text: str) -> Address:
        """Return the address in "host", "host:port", "[address of IPv6]:port" or the bare address."""
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
    """Open a source to pull from.

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
    """Open a paired device as a source; without data it is given up after `patience_s`.

    Errors are those of `open_source`.
    """
    from host_sync.offload.paired_devices import new_private_key
    from host_sync.offload.sftp import SftpSource
    from host_sync.offload.sftp_link import ReconnectingSftp, Timeouts

    if at is not None:
        device = msgspec.structs.replace(device, host=at.host, port=at.port or device.port)
    timeouts = Timeouts.of_patience(patience_s)
    with ReconnectingSftp(device, devices.private_key(new_private_key), timeouts) as link:
        yield SftpSource(link)
