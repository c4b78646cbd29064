"""A source that is a paired device, reached over SFTP."""

from __future__ import annotations

import asyncio
import stat
import time
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import IO, Final

import asyncssh

from device.bundle_layout import BundleKind, is_bundle_id
from device.disk_advice import explain_refusal
from device.receipts import RECEIPTS
from host_sync.errors import HostError, SourceError
from host_sync.offload.sftp_link import LinkBroken, SftpLink
from host_sync.offload.ssh_session import Session

REQUEST_BYTES: Final = 255 << 10
"""The most that OpenSSH's server sends for one request."""

BLOCK_BYTES: Final = 4 * REQUEST_BYTES
"""What is handed on at a time, and the most that a cut costs: about one megabyte."""

BLOCKS_AHEAD: Final = 3
"""Blocks under way, so that neither side ever waits for the other."""

WRITTEN_BYTES: Final = 128 << 10
"""Sent at a time: on the slowest line that is borne, one arrives before patience ends."""

MOST_NAMES: Final = 200_000
"""A folder that lists more is not a device's."""

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
        link = self._link

        async def listed(client: asyncssh.SFTPClient) -> list[str]:
            names: list[str] = []
            async for entry in client.scandir(folder):
                link.note_progress()
                names.append(str(entry.filename))
                if len(names) > MOST_NAMES:
                    break
            return names

        try:
            names = link.persist(listed)
        except asyncssh.SFTPNoSuchFile:
            return []
        except asyncssh.SFTPError as error:
            raise self._refused(folder, "be listed", error) from error
        if len(names) > MOST_NAMES:
            raise SourceError(f"{self.name}/{folder}: holds more than {MOST_NAMES} names: check the device")
        return sorted(name for name in names if name not in (".", ".."))

    def blocks(self, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        """A file's bytes from an offset on, with some requests always under way."""
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
        """Put a file there, durable before it appears under its name; each block that arrives renews patience."""
        link = self._link
        folder, _, name = place.rpartition("/")
        partial = f"{folder}/.{name}.part"

        async def put(client: asyncssh.SFTPClient) -> None:
            async with client.open(partial, "wb") as file:
                with BytesIO(data) if isinstance(data, bytes) else _own_file(data) as stream:
                    while block := _own_block(stream):
                        await file.write(block)
                        link.note_progress()
                with suppress(asyncssh.SFTPOpUnsupported):
                    await file.fsync()
            await client.posix_rename(partial, place)

        try:
            link.persist(put)
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
            self.write(_CLOCK_FILE, b"\n")
            after_s = time.time()
            stamp_s = self._link.persist(lambda client: client.stat(_CLOCK_FILE)).mtime
        except (SourceError, asyncssh.SFTPError):
            return None
        # Stamps of version 3 of the protocol are whole seconds, cut off.
        return None if stamp_s is None else float(stamp_s) + 0.5 - (before_s + after_s) / 2.0

    def _read_ahead(self, session: Session, place: str, offset_bytes: int) -> Generator[bytes, None, None]:
        link = self._link
        self._check_regular(session, place)
        file = link.result(link.submit(_open(session.client, place)))
        asked: deque[Future[bytes]] = deque()
        try:
            asked_bytes = offset_bytes
            while True:
                while len(asked) < BLOCKS_AHEAD:
                    asked.append(link.submit(_read_block(file, asked_bytes, link.note_progress)))
                    asked_bytes += BLOCK_BYTES
                block = link.result(asked.popleft())
                if not block:
                    return
                handed_s = time.monotonic()
                yield block
                link.allow(time.monotonic() - handed_s)
                offset_bytes += len(block)
                if len(block) < BLOCK_BYTES:
                    _cancel(asked)
                    asked_bytes = offset_bytes
        finally:
            _cancel(asked)
            link.submit(_close(file))

    def _check_regular(self, session: Session, place: str) -> None:
        mode = self._link.result(self._link.submit(session.client.lstat(place))).permissions
        if mode is not None and not stat.S_ISREG(mode):
            raise SourceError(f"{self.name}/{place}: is no regular file: fetch the bundle again")

    def _refused(self, place: str, verb: str, error: asyncssh.SFTPError) -> SourceError:
        return SourceError(f"{self.name}/{place}: cannot {verb} ({error.reason or error.code}): check the device")


async def _open(client: asyncssh.SFTPClient, place: str) -> asyncssh.SFTPClientFile:
    # Block size 0: each read is one request, not split further.
    return await client.open(place, "rb", block_size=0)


async def _read_block(file: asyncssh.SFTPClientFile, offset_bytes: int, note_progress: Callable[[], None]) -> bytes:
    """A block from there on; a shorter one, or none, where the file or the connection ends."""

    async def read(at_bytes: int) -> bytes:
        part: bytes = await file.read(REQUEST_BYTES, at_bytes)
        note_progress()
        return part

    places = range(offset_bytes, offset_bytes + BLOCK_BYTES, REQUEST_BYTES)
    parts = await asyncio.gather(*map(read, places), return_exceptions=True)
    came: list[bytes] = []
    for part in parts:
        if isinstance(part, BaseException):
            if not came:
                raise part
            break
        came.append(part)
        if len(part) < REQUEST_BYTES:
            break
    return b"".join(came)


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


def _own_file(path: Path) -> IO[bytes]:
    try:
        return path.open("rb")
    except OSError as error:
        raise HostError(f"{path}: cannot be read {explain_refusal(error)}") from error


def _own_block(stream: IO[bytes]) -> bytes:
    """The next block of a file of ours; that it fails is not the link's fault, and no reason to try again."""
    try:
        return stream.read(WRITTEN_BYTES)
    except OSError as error:
        raise HostError(f"{stream.name}: cannot be read {explain_refusal(error)}") from error


def _cancel(asked: deque[Future[bytes]]) -> None:
    while asked:
        asked.popleft().cancel()
