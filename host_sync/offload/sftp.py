"""A source that is a paired device, reached over SFTP."""

from __future__ import annotations

import os
import stat
import time
from collections import deque
from collections.abc import Awaitable, Generator
from concurrent.futures import Future
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import IO, Final

import asyncssh

from device.bundles.bundle import RECEIPTS, BundleKind, BundleNames, bundle_names
from device.io.folder import MAX_ENTRIES, EntryKind, FolderEntry, open_regular
from device.io.system import explain_os_error
from host_sync.errors import HostError, SourceError
from host_sync.offload.sftp_link import LinkBroken, ReconnectingSftp, Session

REQUEST_BYTES: Final = 255 << 10
"""Maximum that OpenSSH's server sends for one request; at most this much is lost when the connection breaks."""

REQUESTS_AHEAD: Final = 12
"""Requests in flight, so that neither side waits for the other; their answers come in order."""

WRITTEN_BYTES: Final = 128 << 10
"""Size of one write: on the slowest accepted line it arrives before the timeout."""

_CLOCK_FILE: Final = f"{RECEIPTS}/.clock"


class SftpSource:
    """A device's store over an open link; after a reconnection, reading continues at the byte where it stopped."""

    def __init__(self, link: ReconnectingSftp) -> None:
        self._link = link

    @property
    def name(self) -> str:
        """The device's id."""
        return self._link.name

    def bundle_names(self, kind: BundleKind) -> BundleNames:
        """Return ids of the published bundles, and entries that cannot be bundles."""
        return bundle_names(self._entries(kind))

    def names(self, folder: str) -> list[str]:
        """Return names in a folder of the store, sorted; none when there is no such folder."""
        return sorted(entry.name for entry in self._entries(folder))

    def _entries(self, folder: str) -> list[FolderEntry]:
        link = self._link

        async def listed(client: asyncssh.SFTPClient) -> list[FolderEntry]:
            found: list[FolderEntry] = []
            async for entry in client.scandir(folder):
                link.note_progress()
                found.append(FolderEntry(str(entry.filename), _kind(entry.attrs.permissions)))
                if len(found) > MAX_ENTRIES:
                    break
            return found

        try:
            found = link.retry(listed)
        except asyncssh.SFTPNoSuchFile as error:
            if self._is_there(folder):  # OpenSSH says so of what is no folder, too
                raise SourceError(f"{self.name}/{folder}: is no folder: check the device") from error
            return []
        except asyncssh.SFTPError as error:
            raise self._refused(folder, "be listed", error) from error
        if len(found) > MAX_ENTRIES:
            raise SourceError(f"{self.name}/{folder}: holds more than {MAX_ENTRIES} names: check the device")
        return [entry for entry in found if entry.name not in (".", "..")]

    def _is_there(self, place: str) -> bool:
        try:
            self._link.retry(lambda client: client.lstat(place))
        except asyncssh.SFTPError:
            return False
        return True

    def blocks(self, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        """Yield a file's bytes from an offset, with several requests in flight."""
        self._link.note_progress()
        while True:
            session = self._link.session
            try:
                for block in self._read_ahead(session, place, offset_bytes):
                    offset_bytes += len(block)
                    yield block
            except LinkBroken:
                self._link.restore(session)
            except asyncssh.SFTPError as error:
                raise self._refused(place, "be read", error) from error
            else:
                return

    def write(self, place: str, data: bytes | Path) -> None:
        """Put a file there, durable before it appears under its name; each acknowledged block counts as progress."""
        link = self._link
        folder, _, name = place.rpartition("/")
        partial = f"{folder}/.{name}.part"

        async def put(client: asyncssh.SFTPClient) -> None:
            with suppress(asyncssh.SFTPNoSuchFile):
                await client.remove(partial)
            async with client.open(partial, "xb") as file:
                with BytesIO(data) if isinstance(data, bytes) else _own_file(data) as stream:
                    while block := _own_block(stream):
                        await file.write(block)
                        link.note_progress()
                with suppress(asyncssh.SFTPOpUnsupported):
                    await file.fsync()
            await client.posix_rename(partial, place)

        try:
            link.retry(put)
        except asyncssh.SFTPError as error:
            raise self._refused(place, "be written", error) from error

    def make_folder(self, place: str) -> None:
        """Make a folder; an existing one is kept."""
        try:
            if not self._link.retry(lambda client: client.isdir(place)):
                self._link.retry(lambda client: client.mkdir(place))
        except asyncssh.SFTPError as error:
            raise self._refused(place, "be made", error) from error

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder."""
        try:
            self._link.retry(lambda client: _rename(client, place, new_place))
        except asyncssh.SFTPError as error:
            raise self._refused(place, "be renamed", error) from error

    def clock_offset_s(self) -> float | None:
        """Return how far the device's clock is ahead of ours, by the time stamp of a new file.

        None when the device takes no file.
        """
        try:
            before_s = time.time()
            self.write(_CLOCK_FILE, b"\n")
            after_s = time.time()
            stamp_s = self._link.retry(lambda client: client.stat(_CLOCK_FILE)).mtime
        except (SourceError, asyncssh.SFTPError):
            return None
        # SFTP version 3 has time stamps in whole seconds, rounded down.
        return None if stamp_s is None else float(stamp_s) + 0.5 - (before_s + after_s) / 2.0

    def _read_ahead(self, session: Session, place: str, offset_bytes: int) -> Generator[bytes, None, None]:
        link = self._link
        self._check_regular(session, place)
        # Block size 0: each read is one request, not split further, and what came before a cut is kept.
        file = link.result(link.submit(_awaitable(session.client.open(place, "rb", block_size=0))))
        requested: deque[Future[bytes]] = deque()
        requested_bytes = offset_bytes
        try:
            while True:
                while len(requested) < REQUESTS_AHEAD:
                    requested.append(link.submit(file.read(REQUEST_BYTES, requested_bytes)))
                    requested_bytes += REQUEST_BYTES
                block = link.result(requested.popleft())
                if not block:
                    return
                offset_bytes += len(block)
                if len(block) == REQUEST_BYTES:
                    link.note_progress()
                else:  # the file's end, or a server that drips, which is no progress
                    _cancel(requested)
                    requested_bytes = offset_bytes
                    if link.left_s <= 0.0:
                        raise LinkBroken
                handed_s = time.monotonic()
                yield block
                link.pause_timeout(time.monotonic() - handed_s)
        finally:
            _cancel(requested)
            link.submit(_close(file))

    def _check_regular(self, session: Session, place: str) -> None:
        mode = self._link.result(self._link.submit(session.client.lstat(place))).permissions
        if mode is not None and not stat.S_ISREG(mode):
            raise SourceError(f"{self.name}/{place}: is no regular file: fetch the bundle again")

    def _refused(self, place: str, verb: str, error: asyncssh.SFTPError) -> SourceError:
        return SourceError(f"{self.name}/{place}: cannot {verb} ({error.reason or error.code}): check the device")


def _kind(permissions: int | None) -> EntryKind:
    if permissions is None:
        return "other"
    if stat.S_ISDIR(permissions):
        return "folder"
    return "file" if stat.S_ISREG(permissions) else "other"


async def _awaitable(opening: Awaitable[asyncssh.SFTPClientFile]) -> asyncssh.SFTPClientFile:
    return await opening


async def _rename(client: asyncssh.SFTPClient, place: str, new_place: str) -> None:
    """Rename; the rename may have happened already, just before the connection broke."""
    try:
        await client.rename(place, new_place)
    except asyncssh.SFTPNoSuchFile:
        if not await client.exists(new_place):
            raise


async def _close(file: asyncssh.SFTPClientFile) -> None:
    with suppress(asyncssh.Error, asyncssh.SFTPError, OSError):
        await file.close()


def _own_file(path: Path) -> IO[bytes]:
    try:
        return os.fdopen(open_regular(path), "rb")
    except OSError as error:
        raise HostError(f"{path}: cannot be read {explain_os_error(error)}") from error


def _own_block(stream: IO[bytes]) -> bytes:
    """Return the next block of a file of ours; an error here is not the link's, so it is not retried."""
    try:
        return stream.read(WRITTEN_BYTES)
    except OSError as error:
        raise HostError(f"a file of the library cannot be read {explain_os_error(error)}") from error


def _cancel(requested: deque[Future[bytes]]) -> None:
    while requested:
        requested.popleft().cancel()
