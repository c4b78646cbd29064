"""Runs the viewer's server, with limits on connections whose clients keep it waiting."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from host_sync.errors import ViewError
from host_sync.viewer.access import LOOPBACK

MAX_PORT_TRIALS: Final = 50
MAX_MESSAGE: Final = 4096
"""Bytes of a page's message to the server, at most."""
_NO_SUCH_FAMILY: Final = frozenset({errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT})


@dataclass(frozen=True, slots=True)
class ConnectionLimits:
    """Limits on connections.

    request_s : longest wait for a complete request, s
    stalled_s : longest wait for a client that does not read its answer, s
    connections : beyond this number the connection that has waited longest for a request is closed
    waiting : connections without a request, longest wait first
    """

    request_s: float = 10.0
    stalled_s: float = 30.0
    connections: int = 128
    waiting: dict[LimitedConnection, None] = field(default_factory=dict)


class LimitedConnection(H11Protocol):
    """An HTTP connection that ends when its client keeps the server waiting. uvicorn itself waits without limit."""

    def __init__(self, *arguments: Any, limits: ConnectionLimits, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._limits = limits
        self._timers: dict[str, asyncio.TimerHandle] = {}

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._wait()
        if len(self.connections) > self._limits.connections:
            next(iter(self._limits.waiting)).transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop all timers."""
        self._limits.waiting.pop(self, None)
        for name in tuple(self._timers):
            self._stop(name)
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Leave the connection to a web socket, which has pings of its own."""
        self._limits.waiting.pop(self, None)
        self._stop("request")
        super().handle_websocket_upgrade(event)

    def handle_events(self) -> None:
        """Take what came; a complete request ends the wait."""
        super().handle_events()
        cycle: RequestResponseCycle | None = self.cycle
        if cycle is not None and not cycle.response_complete:
            self._limits.waiting.pop(self, None)
            self._stop("request")

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._wait()
        super().on_response_complete()

    def pause_writing(self) -> None:
        """The client is slower than the answer."""
        super().pause_writing()
        self._start("stalled", self._limits.stalled_s)

    def resume_writing(self) -> None:
        """The client reads on."""
        super().resume_writing()
        self._stop("stalled")

    def _wait(self) -> None:
        self._limits.waiting.pop(self, None)
        self._limits.waiting[self] = None
        self._start("request", self._limits.request_s)

    def _start(self, name: str, seconds: float) -> None:
        self._stop(name)
        self._timers[name] = self.loop.call_later(seconds, self.transport.abort)

    def _stop(self, name: str) -> None:
        timer = self._timers.pop(name, None)
        if timer is not None:
            timer.cancel()


@contextmanager
def listening(host: str, port: int) -> Iterator[list[socket.socket]]:
    """Listening sockets at an address, on one port; port 0 takes a free one.

    On loopback the port is taken for IPv4 and IPv6: a browser may try either for a name below `localhost`, and another
    user must not be able to listen on the one that is left.

    Raises
    ------
    ViewError
        The address is not available.
    """
    hosts = {"127.0.0.1": ["127.0.0.1", "::1"], "localhost": ["127.0.0.1", "::1"], "::1": ["::1", "127.0.0.1"]}.get(
        host, [host]
    )
    with ExitStack() as stack:
        for trial in range(MAX_PORT_TRIALS):
            try:
                listeners = _listeners(hosts, port)
                break
            except (OSError, OverflowError) as error:
                taken = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
                if port or not taken or trial == MAX_PORT_TRIALS - 1:
                    raise ViewError(
                        f"{host}:{port} is not available ({error}): choose another --port or --host"
                    ) from error
        for one in listeners:
            stack.enter_context(one)
        yield listeners


def is_free(host: str, port: int) -> bool:
    """Return whether one can listen there."""
    try:
        with listening(host, port):
            return True
    except ViewError:
        return False


def _listeners(hosts: list[str], port: int) -> list[socket.socket]:
    """Return sockets on one port at the first host and at the others whose address family this machine has."""
    with ExitStack() as stack:
        listeners: list[socket.socket] = []
        for host in hosts:
            try:
                one = _listener(host, listeners[0].getsockname()[1] if listeners else port)
            except OSError as error:
                if not listeners or error.errno not in _NO_SUCH_FAMILY:
                    raise
            else:
                listeners.append(stack.enter_context(one))
        stack.pop_all()
        return listeners


def _listener(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    one = socket.socket(family, socket.SOCK_STREAM)
    try:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6 and host in LOOPBACK:
            one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        one.bind((host, port))
        one.listen(64)
    except BaseException:
        one.close()
        raise
    return one


def make_server(app: ASGIApp, limits: ConnectionLimits | None = None) -> uvicorn.Server:
    """Return the server of an application; `run(sockets=[…])` serves until `should_exit` is set."""
    config = uvicorn.Config(
        app,
        http=partial(LimitedConnection, limits=limits or ConnectionLimits()),  # type: ignore[arg-type]
        log_level="error",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        ws_max_size=MAX_MESSAGE,
        timeout_graceful_shutdown=1,
    )
    return uvicorn.Server(config)
