"""An SFTP connection over SSH that reconnects by itself, with bounded waiting: pinned host key, fast ciphers.

It runs in its own thread, so that hashing and writing on this side continue while the next blocks arrive.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Final, TypeVar

import asyncssh

from host_sync.errors import SourceLost, SourceRefused
from host_sync.offload.paired_devices import PairedDevice
from host_sync.offload.source import PATIENCE_S

T = TypeVar("T")

LOST: Final = (asyncssh.Error, OSError)
"""What a lost or failed connection raises; a timeout is an OSError."""

KEEPALIVES: Final = 8
"""Keepalive messages that a connection is given before it is given up."""

MAX_RETRIES: Final = 20
"""Limit for work that cannot continue where it stopped and starts again."""


class LinkBroken(Exception):
    """The connection is lost; `ReconnectingSftp.restore` reconnects or says why it cannot."""


class ReconnectingSftp:
    """One device's connection; a context manager. Threads may share it: one reconnects, the others wait.

    Raises
    ------
    SourceLost
        The device cannot be reached.
    SourceRefused
        It shows another key than it was paired with, or does not accept ours.
    """

    def __init__(self, device: PairedDevice, private_key: Path, timeouts: Timeouts) -> None:
        self._device = device
        self._private_key = private_key
        self._timeouts = timeouts
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=f"sftp {device.device_id}", daemon=True)
        self._session: Session | None = None
        self._reconnect_lock = threading.Lock()
        self._lost: SourceLost | SourceRefused | None = None
        self._last_byte_s = 0.0
        self._tried_late = False

    def __enter__(self) -> ReconnectingSftp:
        self._thread.start()
        try:
            self.note_progress()
            self.restore(None)
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    @property
    def name(self) -> str:
        """The device, for messages."""
        return self._device.device_id

    @property
    def session(self) -> Session:
        """The current session; it may be broken already."""
        if self._session is None:
            raise LinkBroken
        return self._session

    def note_progress(self) -> None:
        """Restart the timeout: data arrived, or a first request was sent. A new connection alone is no progress."""
        self._last_byte_s = time.monotonic()
        self._tried_late = False

    @property
    def left_s(self) -> float:
        """Time until the link is given up, unless data arrive, s."""
        return self._last_byte_s + self._timeouts.give_up_s - time.monotonic()

    def pause_timeout(self, busy_s: float) -> None:
        """Leave time that this side took for itself out of the timeout."""
        self._last_byte_s += busy_s

    def submit(self, work: Coroutine[Any, Any, T]) -> Future[T]:
        """Start work on the connection."""
        return asyncio.run_coroutine_threadsafe(work, self._loop)

    def result(self, future: Future[T]) -> T:
        """Return the result of started work.

        Raises
        ------
        LinkBroken
            The connection is lost, or nothing arrived within the timeout.
        asyncssh.SFTPError
            The device refused this request.
        """
        try:
            return self._awaited(future)
        except LOST as error:
            future.cancel()
            if isinstance(error, asyncssh.SFTPError) and not isinstance(
                error, asyncssh.SFTPConnectionLost | asyncssh.SFTPNoConnection
            ):
                raise
            raise LinkBroken from error

    def retry(self, work: Callable[[asyncssh.SFTPClient], Coroutine[Any, Any, T]]) -> T:
        """Return the result of work that may start again on a new connection. Errors as for `restore` and `result`."""
        self.note_progress()
        for _ in range(MAX_RETRIES):
            session = self.session
            try:
                return self.result(self.submit(work(session.client)))
            except LinkBroken:
                self.restore(session)
        raise self._breaking()

    def _breaking(self) -> SourceLost:
        return SourceLost(
            f"{self.name}: the connection keeps breaking: check cable or network and repeat; what arrived is kept"
        )

    def restore(self, broken: Session | None) -> None:
        """Replace the broken session by a new one, trying until the timeout.

        Raises
        ------
        SourceLost, SourceRefused
            As for the constructor; after the first time without another try.
        """
        with self._reconnect_lock:
            if self._lost is not None:
                raise self._lost
            if self._session is broken:
                self._drop()
                try:
                    self._session = self._connected()
                except (SourceLost, SourceRefused) as error:
                    self._lost = error
                    raise

    def _awaited(self, future: Future[T]) -> T:
        """Return the result of a future, awaited as long as data keeps arriving."""
        while True:
            left_s = self.left_s
            try:
                return future.result(timeout=max(left_s, self._timeouts.retry_s))
            except TimeoutError:
                if future.done() or left_s <= self._timeouts.retry_s:
                    raise

    def _connected(self) -> Session:
        refusals = 0
        while True:
            left_s = self.left_s
            if left_s <= 0.0 and self._tried_late:  # it connects, breaks, and brings nothing
                raise self._breaking()
            self._tried_late = left_s <= 0.0
            try:
                return self.submit(self._open(max(left_s, self._timeouts.retry_s))).result()
            except LOST as error:
                refusals += isinstance(error, asyncssh.HostKeyNotVerifiable | asyncssh.PermissionDenied)
                if refusals > 1:
                    raise SourceRefused(describe_refusal(self._device, error)) from error
                if left_s <= 0.0:
                    raise SourceLost(
                        f"{self.name}: cannot be reached at {self._device.host}:{self._device.port} "
                        f"({str(error) or 'no answer'}): check cable or network and repeat; what arrived is kept"
                    ) from error
            threading.Event().wait(self._timeouts.retry_s)

    def _open(self, within_s: float) -> Coroutine[Any, Any, Session]:
        return open_session(self._device, self._private_key, self._timeouts, within_s)

    def _drop(self) -> None:
        if self._session is not None:
            self._loop.call_soon_threadsafe(self._session.connection.abort)

    def _stop(self) -> None:
        self._drop()
        self.submit(_finish_tasks()).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def _finish_tasks() -> None:
    """Cancel and await all tasks, so that none reports after the link is closed."""
    tasks = asyncio.all_tasks() - {asyncio.current_task()}
    for task in tasks:
        task.cancel()
    if tasks:
        ended, _ = await asyncio.wait(tasks, timeout=1.0)
        await asyncio.gather(*ended, return_exceptions=True)


CIPHERS: Final = ("aes128-gcm@openssh.com", "aes256-gcm@openssh.com", "chacha20-poly1305@openssh.com")
PACKET_BYTES: Final = 128 << 10

_SIGNATURES: Final = {"ssh-rsa": ["rsa-sha2-512", "rsa-sha2-256"]}
"""Signature algorithms of key types whose name is not also the algorithm's."""


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """One connection and the SFTP session on it; replaced after a reconnection."""

    connection: asyncssh.SSHClientConnection
    client: asyncssh.SFTPClient


@dataclass(frozen=True, slots=True)
class Timeouts:
    """Timeouts of a connection, s.

    keepalive_s : interval of keepalive messages
    unanswered : unanswered keepalives after which the connection counts as lost
    give_up_s : without any data, after which reconnecting ends
    retry_s : between two attempts
    """

    keepalive_s: float = PATIENCE_S / KEEPALIVES
    unanswered: int = 3
    give_up_s: float = PATIENCE_S
    retry_s: float = 0.25

    @classmethod
    def of_patience(cls, give_up_s: float) -> Timeouts:
        """Return those that give up after so long without data, a positive number, with keepalives in proportion."""
        return cls(keepalive_s=give_up_s / KEEPALIVES, give_up_s=give_up_s)


async def open_session(device: PairedDevice, private_key: Path, timeouts: Timeouts, within_s: float) -> Session:
    """A new session with a device, accepted only with its pinned host key.

    Raises
    ------
    asyncssh.Error, OSError
        It cannot be reached within that time, presents another key, or does not accept ours.
    """
    key = asyncssh.import_public_key(device.host_key)
    kind = device.host_key.partition(" ")[0]
    async with asyncio.timeout(within_s):
        connection = await asyncssh.connect(
            device.host,
            device.port,
            username=device.user,
            client_keys=[str(private_key)],
            known_hosts=([key], [], []),
            server_host_key_algs=_SIGNATURES.get(kind, [kind]),
            encryption_algs=CIPHERS,
            compression_algs=None,
            preferred_auth="publickey",
            agent_path=None,
            config=None,
            keepalive_interval=timeouts.keepalive_s,
            keepalive_count_max=timeouts.unanswered,
        )
        try:
            # The only way to set the packet size of the SFTP session; large packets save a seventh of the time.
            session = partial(connection.create_session, max_pktsize=PACKET_BYTES)
            connection.create_session = session  # type: ignore[method-assign]
            return Session(connection, await connection.start_sftp_client(path_errors="surrogateescape"))
        except BaseException:
            connection.abort()
            raise


def describe_refusal(device: PairedDevice, cause: BaseException) -> str:
    """Return what a refusal means and what to do, in one sentence."""
    where = f"{device.device_id} ({device.host}:{device.port})"
    if isinstance(cause, asyncssh.HostKeyNotVerifiable):
        return (
            f"{where}: presents another host key than when it was paired, so it was set up again or something else "
            "answers in its place: pair it again with --replace only if you set it up again yourself"
        )
    return f"{where}: does not accept this workstation's key: pair it again"
