"""A source that is a paired device, reached over SFTP."""

from __future__ import annotations

import stat
import time
from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import Future
from contextlib import suppress
from typing import Final

import asyncssh

from device.bundle_layout import BundleKind, is_bundle_id
from device.receipts import RECEIPTS
from host_sync.errors import SourceError
from host_sync.offload.sftp_link import LinkBroken, SftpLink

REQUEST_BYTES: Final = 255 << 10
"""The most that OpenSSH's server sends for one request."""

REQUESTS_AHEAD: Final = 4
"""Requests under way: what a cut costs is at most these, about one megabyte."""

_CLOCK_FILE: Final = f"{RECEIPTS}/.clock"


class SftpSource:
    """A device's store over a link that is open; a cut is mended and reading goes on at the byte where it stopped."""

    def __init__(self, link: SftpLink) -> None:
        self._link = link

    @property
    def name(self) -> str:
        """The device's id."""
        return self._link.name

    def bundle_ids(self, kind: BundleKind) -> list[str]:
        """Ids of the published bundles, sorted."""
        return [name for name in self.names(kind) if is_bundle_id(name)]

    def names(self, folder: str) -> list[str]:
        """Names in a folder of the store, sorted; none when there is no such folder."""
        try:
            names = self._link.persist(lambda client: client.listdir(folder))
        except asyncssh.SFTPNoSuchFile:
            return []
        except asyncssh.SFTPError as error:
            raise self._refused(folder, "be listed", error) from error
        return sorted(str(name) for name in names if name not in (".", ".."))

    def blocks(self, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        """A file's bytes from an offset on, with some requests always under way."""
        self._link.note_progress()
        while True:
            try:
                for block in self._read_ahead(place, offset_bytes):
                    offset_bytes += len(block)
                    yield block
            except LinkBroken:
                self._link.restore()
            except asyncssh.SFTPError as error:
                raise self._refused(place, "be read", error) from error
            else:
                return

    def write(self, place: str, blocks: Iterable[bytes]) -> None:
        """Put a file there, durable before it appears under its name."""
        kept = list(blocks) if not isinstance(blocks, (list, tuple)) else blocks
        folder, _, name = place.rpartition("/")
        partial = f"{folder}/.{name}.part"

        async def put(client: asyncssh.SFTPClient) -> None:
            async with client.open(partial, "wb") as file:
                for block in kept:
                    await file.write(block)
                with suppress(asyncssh.SFTPOpUnsupported):
                    await file.fsync()
            await client.posix_rename(partial, place)

        try:
            self._link.persist(put)
        except asyncssh.SFTPError as error:
            raise self._refused(place, "be written", error) from error

    def make_folder(self, place: str) -> None:
        """Make a folder; one that is there is kept."""
        try:
            if not self._link.persist(lambda client: client.isdir(place)):
                self._link.persist(lambda client: client.mkdir(place))
        except asyncssh.SFTPError as error:
            raise self._refused(place, "be made", error) from error

    def rename(self, place: str, new_place: str) -> None:
        """Rename a file or folder."""
        try:
            self._link.persist(lambda client: _rename(client, place, new_place))
        except asyncssh.SFTPError as error:
            raise self._refused(place, "be renamed", error) from error

    def clock_offset_s(self) -> float | None:
        """How far the device's clock is ahead of ours, s, by the time stamp of a file that it writes; None when it
        takes none."""
        try:
            before_s = time.time()
            self.write(_CLOCK_FILE, [b"\n"])
            after_s = time.time()
            stamp_s = self._link.persist(lambda client: client.stat(_CLOCK_FILE)).mtime
        except (SourceError, asyncssh.SFTPError):
            return None
        # Stamps of version 3 of the protocol are whole seconds, cut off.
        return None if stamp_s is None else float(stamp_s) + 0.5 - (before_s + after_s) / 2.0

    def _read_ahead(self, place: str, offset_bytes: int) -> Generator[bytes, None, None]:
        link = self._link
        self._check_regular(place)
        file = link.result(link.submit(_open(link.client, place)))
        requests: deque[Future[bytes]] = deque()
        try:
            asked_bytes = offset_bytes
            while True:
                while len(requests) < REQUESTS_AHEAD:
                    requests.append(link.submit(file.read(REQUEST_BYTES, asked_bytes)))
                    asked_bytes += REQUEST_BYTES
                block = link.result(requests.popleft())
                if not block:
                    return
                yield block
                link.note_progress()
                offset_bytes += len(block)
                if len(block) < REQUEST_BYTES:
                    _cancel(requests)
                    asked_bytes = offset_bytes
        finally:
            _cancel(requests)
            link.submit(_close(file))

    def _check_regular(self, place: str) -> None:
        mode = self._link.result(self._link.submit(self._link.client.lstat(place))).permissions
        if mode is not None and not stat.S_ISREG(mode):
            raise SourceError(f"{self.name}/{place}: is no regular file: fetch the bundle again")

    def _refused(self, place: str, verb: str, error: asyncssh.SFTPError) -> SourceError:
        return SourceError(f"{self.name}/{place}: cannot {verb} ({error.reason or error.code}): check the device")


async def _open(client: asyncssh.SFTPClient, place: str) -> asyncssh.SFTPClientFile:
    # Block size 0: each read is one request, not split further.
    return await client.open(place, "rb", block_size=0)


async def _rename(client: asyncssh.SFTPClient, place: str, new_place: str) -> None:
    """Rename, or find that it was done just before a cut."""
    try:
        await client.rename(place, new_place)
    except asyncssh.SFTPNoSuchFile:
        if not await client.exists(new_place):
            raise


async def _close(file: asyncssh.SFTPClientFile) -> None:
    with suppress(asyncssh.Error, asyncssh.SFTPError, OSError):
        await file.close()


def _cancel(requests: deque[Future[bytes]]) -> None:
    while requests:
        requests.popleft().cancel()
