"""A connection over SSH that mends itself: it lives in a thread of its own, and what waits for it waits a bounded time.

Why a thread: hashing and writing on this side go on while the next blocks come in.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from pathlib import Path
from types import TracebackType
from typing import Any, Final, TypeVar

import asyncssh

from host_sync.errors import SourceLost, SourceRefused
from host_sync.offload.paired_devices import PairedDevice
from host_sync.offload.ssh_session import Patience, Session, explain_refusal, open_session

T = TypeVar("T")

LOST: Final = (asyncssh.Error, OSError)
"""What a connection that is gone, or never came about, raises; a time-out is an OSError."""

MOST_BEGINNINGS: Final = 20
"""Work that cannot go on where it stopped is begun so often, and no more."""


class LinkBroken(Exception):
    """The connection is gone; `SftpLink.restore` brings it back or says why not."""


class SftpLink:
    """One device's connection; a context manager. Several threads may use it: one mends it, the others wait.

    Raises
    ------
    SourceLost
        The device cannot be reached.
    SourceRefused
        It shows another key than it was paired with, or does not accept ours.
    """

    def __init__(self, device: PairedDevice, private_key: Path, patience: Patience) -> None:
        self._device = device
        self._private_key = private_key
        self._patience = patience
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=f"sftp {device.device_id}", daemon=True)
        self._session: Session | None = None
        self._mending = threading.Lock()
        self._lost: SourceLost | SourceRefused | None = None
        self._last_byte_s = 0.0

    def __enter__(self) -> SftpLink:
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
        """The present session, which may be broken already."""
        if self._session is None:
            raise LinkBroken
        return self._session

    def note_progress(self) -> None:
        """Something came, or is asked for first: patience begins anew. A new connection alone is no progress."""
        self._last_byte_s = time.monotonic()

    def allow(self, busy_s: float) -> None:
        """Time that this side needed for itself is no silence of the other's."""
        self._last_byte_s += busy_s

    def submit(self, work: Coroutine[Any, Any, T]) -> Future[T]:
        """Begin some work on the connection."""
        return asyncio.run_coroutine_threadsafe(work, self._loop)

    def result(self, future: Future[T]) -> T:
        """What begun work returns.

        Raises
        ------
        LinkBroken
            The connection is gone, or nothing came for longer than patience allows.
        asyncssh.SFTPError
            The device refused just this.
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

    def persist(self, work: Callable[[asyncssh.SFTPClient], Coroutine[Any, Any, T]]) -> T:
        """What some work returns that may be begun again on a new connection. Errors as for `restore` and `result`."""
        self.note_progress()
        for _ in range(MOST_BEGINNINGS):
            session = self.session
            try:
                return self.result(self.submit(work(session.client)))
            except LinkBroken:
                self.restore(session)
        raise SourceLost(
            f"{self.name}: breaks off again and again: check cable or network and repeat; what came is kept"
        )

    def restore(self, broken: Session | None) -> None:
        """Have another session than the broken one, trying until patience ends.

        Raises
        ------
        SourceLost, SourceRefused
            As when the link is made; from then on at once.
        """
        with self._mending:
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
        """What a future returns, awaited for as long as something comes now and then."""
        while True:
            left_s = self._last_byte_s + self._patience.give_up_s - time.monotonic()
            try:
                return future.result(timeout=max(left_s, self._patience.retry_s))
            except TimeoutError:
                if future.done() or left_s <= self._patience.retry_s:
                    raise

    def _connected(self) -> Session:
        refusals = 0
        while True:
            left_s = self._last_byte_s + self._patience.give_up_s - time.monotonic()
            try:
                return self.submit(self._open(max(left_s, self._patience.retry_s))).result()
            except LOST as error:
                refusals += isinstance(error, asyncssh.HostKeyNotVerifiable | asyncssh.PermissionDenied)
                if refusals > 1:
                    raise SourceRefused(explain_refusal(self._device, error)) from error
                if left_s <= 0.0:
                    raise SourceLost(
                        f"{self.name}: cannot be reached at {self._device.host}:{self._device.port} "
                        f"({str(error) or 'no answer'}): check cable or network and repeat; what came is kept"
                    ) from error
            threading.Event().wait(self._patience.retry_s)

    def _open(self, within_s: float) -> Coroutine[Any, Any, Session]:
        return open_session(self._device, self._private_key, self._patience, within_s)

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
    """Let what was begun end, so that nothing speaks up after the link is gone."""
    tasks = asyncio.all_tasks() - {asyncio.current_task()}
    for task in tasks:
        task.cancel()
    if tasks:
        ended, _ = await asyncio.wait(tasks, timeout=1.0)
        await asyncio.gather(*ended, return_exceptions=True)
