"""Runs the viewer until it is stopped."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from starlette.types import ASGIApp

from host_sync.errors import ViewError


@contextmanager
def listening(host: str, port: int) -> Iterator[socket.socket]:
    """A socket at an address; port 0 takes a free one.

    Raises
    ------
    ViewError
        The address cannot be had.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(64)
        yield listener
    except (OSError, OverflowError) as error:
        raise ViewError(f"{host}:{port} cannot be listened at ({error}): choose another --port or --host") from error
    finally:
        listener.close()


def make_server(app: ASGIApp) -> uvicorn.Server:
    """The server of an application; `run(sockets=[…])` serves until it is told to exit."""
    config = uvicorn.Config(
        app,
        log_level="error",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="none",
        timeout_graceful_shutdown=1,
    )
    return uvicorn.Server(config)
