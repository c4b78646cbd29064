"""Limits on what a test waits for: programs, connections and threads."""

from __future__ import annotations

import socket
import subprocess
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from threading import Thread, Timer
from typing import Any

import pytest

WAIT_S = 300.0
"""Half of what pytest allows a test; the slowest program of the tests takes a minute."""


@pytest.fixture(scope="session", autouse=True)
def limited_waits(pytestconfig: pytest.Config) -> Iterator[None]:
    """Programs that are run and connections that are awaited end in time, unless a test states another limit.

    Where tests have no limit (emulated boards, power cuts), what they wait for has none.
    """
    if not pytestconfig.getini("faulthandler_timeout"):
        yield
        return
    run = subprocess.run
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocess, "run", lambda *command, **named: run(*command, **{"timeout": WAIT_S} | named))
        socket.setdefaulttimeout(WAIT_S)
        yield
        socket.setdefaulttimeout(None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Show what a program had written that did not end in time."""
    report = yield
    error = call.excinfo and call.excinfo.value
    if isinstance(error, subprocess.TimeoutExpired):
        for name, said in (("output", error.stdout), ("error output", error.stderr)):
            report.sections.append((f"Program's {name}", said.decode(errors="replace") if said else "nothing"))
    return report


@contextmanager
def running(command: Sequence[Any], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """A program beside the test; it is killed when the test waits too long for a line of it, or for its end."""
    program = subprocess.Popen(command, **options)
    limit = Timer(WAIT_S, program.kill)
    limit.start()
    try:
        with program:
            yield program
    finally:
        expired = limit.finished.is_set()
        limit.cancel()
        if expired:
            pytest.fail(f"was killed after {WAIT_S:g} s: {program.args}")


def join(thread: Thread) -> None:
    """Wait for the end of a thread."""
    thread.join(WAIT_S)
    assert not thread.is_alive(), f"the thread {thread.name!r} did not end"
