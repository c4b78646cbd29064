"""Processes that take one task at a time; the task of a process that dies goes to a new one.

A task leaves the caller when a process is free for it, so however many there are, as many as processes are under way.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection, get_context
from typing import Final, Generic, TypeVar

from host_sync.kernels.process_settings import kept_memory

ATTEMPTS: Final = 3
"""A task whose process died so many times is given up."""

ONE_THREAD: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""What libraries read when they are loaded; each process computes with one thread."""

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


@dataclass(frozen=True, slots=True)
class Lost:
    """A task that was given up: its process died every time, the last time with this exit code."""

    exit_code: int | None

    @property
    def reason(self) -> str:
        """Return what happened, as a sentence."""
        end = f"signal {-self.exit_code}" if self.exit_code and self.exit_code < 0 else f"exit code {self.exit_code}"
        return f"the process that worked on it ended {ATTEMPTS} times ({end}): try it alone, or with fewer workers"


@dataclass(slots=True)
class _Order(Generic[Task]):
    """A task and how many processes died of it."""

    task: Task
    deaths: int = 0


class _Worker(Generic[Task, Outcome]):
    """A process, the pipe to it, and what it works on."""

    def __init__(self, setup: Callable[[], Callable[[Task], Outcome]]) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, setup), daemon=True)
        with _one_thread():
            self._process.start()
        theirs.close()  # so that its death ends the pipe
        self.order: _Order[Task] | None = None

    def begin(self, order: _Order[Task]) -> None:
        """Give it a task. One that died meanwhile is found when its outcome is asked for."""
        self.order = order
        with suppress(BrokenPipeError):
            self.pipe.send(order.task)

    def outcome(self) -> Outcome:
        """Return what became of its task.

        Raises
        ------
        EOFError, OSError
            It died.
        """
        received: Outcome = self.pipe.recv()
        self.order = None
        return received

    def end(self) -> int | None:
        """Let it end, at once if it is busy; returns its exit code."""
        self.pipe.close()
        if self.order is not None:
            self._process.terminate()
        self._process.join()
        return self._process.exitcode


def outcomes_of(
    tasks: Iterable[Task],
    setup: Callable[[], Callable[[Task], Outcome]],
    workers: int,
    *,
    first_alone: bool = False,
) -> Iterator[tuple[Task, Outcome | Lost]]:
    """Yield every task with its outcome, once, in the order in which they are done.

    tasks : picklable; the next one is asked for when a process is free
    setup : picklable; called once in each process, returns what turns a task into an outcome there
    workers : processes at a time
    first_alone : the first task is done before another begins: it compiles what all need

    A task may be begun up to `ATTEMPTS` times; what it writes must appear whole or not at all.
    """
    waiting = (_Order(task) for task in tasks)
    again: list[_Order[Task]] = []
    idle: list[_Worker[Task, Outcome]] = []
    busy: list[_Worker[Task, Outcome]] = []
    allowed = 1 if first_alone else workers
    try:
        while True:
            while len(busy) < allowed and (order := again.pop() if again else next(waiting, None)) is not None:
                busy.append(idle.pop() if idle else _Worker(setup))
                busy[-1].begin(order)
            if not busy:
                return
            ready = connection.wait([worker.pipe for worker in busy])
            for worker in [one for one in busy if one.pipe in ready]:
                order = worker.order
                assert order is not None  # noqa: S101 - it is busy
                busy.remove(worker)
                try:
                    outcome: Outcome | Lost = worker.outcome()
                except (EOFError, OSError):
                    exit_code = worker.end()
                    order.deaths += 1
                    if order.deaths < ATTEMPTS:
                        again.append(order)
                        continue
                    outcome = Lost(exit_code)
                else:
                    idle.append(worker)
                allowed = workers
                yield order.task, outcome
    finally:
        for worker in idle + busy:
            worker.end()


def _serve(pipe: connection.Connection, setup: Callable[[], Callable[[Task], Outcome]]) -> None:
    """Work until the caller closes the pipe or is gone; an interrupt from the terminal is the caller's affair."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    work = setup()
    with kept_memory():
        while True:
            try:
                task = pipe.recv()
            except EOFError:
                return
            outcome = work(task)
            try:
                pipe.send(outcome)
            except BrokenPipeError:
                return


@contextmanager
def _one_thread() -> Iterator[None]:
    """Context in which a process that starts computes with one thread."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
