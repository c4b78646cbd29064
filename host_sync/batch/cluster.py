"""Tasks for the workers of a dask cluster: the work of `worker_pool`, on other computers.

Each worker has one task at a time, so however many there are, as many as workers are under way. The scheduler gives
the task of a worker that dies to another one, `distributed.scheduler.allowed-failures` times.
"""

from __future__ import annotations

import logging
import os
import time
import warnings
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar
from uuid import uuid4

from device.errors import DeviceError
from host_sync.errors import ClusterError, HostError
from host_sync.kernels.cache import configure_cache

if TYPE_CHECKING:
    from distributed import Client, Future

ANSWER_S: Final = 10.0
"""A scheduler, and the first worker, must answer within this time."""

LOOK_S: Final = 2.0
"""While no task ends, workers are counted so often."""

NO_WORKER_S: Final = 60.0
"""Work ends when there was no worker for this time."""

COMPUTING: Final = ("retrograph", "numpy", "scipy", "numba", "opencv-contrib-python-headless")
"""Packages whose versions decide about the bits of results."""

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


@dataclass(frozen=True, slots=True)
class Unfinished:
    """A task that no worker finished, and why."""

    reason: str


@dataclass(frozen=True, slots=True)
class _Job(Generic[Task, Outcome]):
    """Set-up of a worker; one object a job.

    setup : called once in each worker, returns what turns a task into an outcome there
    shared : folder that was made for this job on storage that all share
    versions : of the packages that compute
    """

    setup: Callable[[], Callable[[Task], Outcome]]
    shared: Path
    versions: tuple[tuple[str, str], ...]
    token: str


@contextmanager
def connected(place: str, answer_s: float = ANSWER_S) -> Iterator[Client]:
    """Context with the client of a cluster that has workers.

    place : the scheduler's address, such as tcp://host:8786, or its file

    Raises
    ------
    ClusterError
        dask is not installed, the scheduler does not answer, or it has no workers.
    """
    if find_spec("distributed") is None:
        raise ClusterError("--cluster needs dask: pip install 'retrograph[cluster]'")
    if "://" not in place and not Path(place).is_file():
        raise ClusterError(f"{place} is neither an address such as tcp://host:8786 nor a scheduler's file: name one")
    with _quiet():
        from distributed import Client

        where = {"address": place} if "://" in place else {"scheduler_file": place}
        try:
            client = Client(**where, timeout=answer_s, set_as_default=False)
        except (OSError, ValueError, KeyError) as error:
            raise ClusterError(
                f"the scheduler of {place} does not answer: start one with `dask scheduler`, or correct the address"
            ) from error
        with client:
            try:
                client.wait_for_workers(1, timeout=answer_s)
            except TimeoutError as error:
                raise ClusterError(
                    f"the scheduler of {place} has no workers: start some with `dask worker {place} --nthreads 1`"
                ) from error
            yield client


def outcomes_on_cluster(
    client: Client,
    tasks: Iterable[Task],
    setup: Callable[[], Callable[[Task], Outcome]],
    shared: Path,
    *,
    no_worker_s: float = NO_WORKER_S,
) -> Iterator[tuple[Task, Outcome | Unfinished]]:
    """Yield every task with its outcome, once, in the order in which they are done.

    tasks : picklable; the next one is asked for when a worker is free
    setup : picklable and hashable; called once in each worker, returns what turns a task into an outcome there
    shared : folder that was made for this job on storage that all share

    A task may be begun several times; what it writes must appear whole or not at all.

    Raises
    ------
    ClusterError
        A worker has several threads, other versions, or does not see the folder; scheduler or all workers were lost.
    """
    job: _Job[Task, Outcome] = _Job(_hashable(setup), shared, computing_versions(), uuid4().hex)
    with _lost_is_said():
        _check_workers(client, job)
    waiting = iter(tasks)
    under_way: dict[Future, Task] = {}
    ended: SimpleQueue[Future] = SimpleQueue()
    seen = time.monotonic()
    try:
        while True:
            with _lost_is_said():
                workers = len(client.nthreads())
            while len(under_way) < max(workers, 1) and (task := next(waiting, None)) is not None:
                future = client.submit(_work, job, task, key=f"scan-{uuid4().hex}")
                under_way[future] = task
                future.add_done_callback(ended.put)
            if not under_way:
                return
            seen = time.monotonic() if workers else seen
            try:
                future = ended.get(timeout=min(LOOK_S, no_worker_s))
            except Empty:
                if time.monotonic() - seen > no_worker_s:
                    raise ClusterError(
                        f"the cluster had no worker for {no_worker_s:g} s: start some and repeat"
                    ) from None
                continue
            with _lost_is_said():
                outcome = _outcome(future)
            yield under_way.pop(future), outcome
    finally:
        if under_way and client.status == "running":
            client.cancel(list(under_way))


def computing_versions() -> tuple[tuple[str, str], ...]:
    """Return versions of the packages that compute, here."""
    return tuple((name, version(name)) for name in COMPUTING)


def _hashable(setup: Callable[[], Callable[[Task], Outcome]]) -> Callable[[], Callable[[Task], Outcome]]:
    assert isinstance(setup, Hashable)  # noqa: S101 - a worker keeps what it was set up for
    return setup


def _check_workers(client: Client, job: _Job[Any, Any]) -> None:
    """Refuse workers whose results could not be trusted or seen."""
    for address, threads in client.nthreads().items():
        if threads != 1:
            raise ClusterError(f"worker {address} has {threads} threads: start it with `dask worker --nthreads 1`")
    for address, said in client.run(_unfit, job, on_error="return").items():
        if said is not None:
            words = said if isinstance(said, str) else f"cannot load retrograph ({said}): install it there"
            raise ClusterError(f"worker {address} {words}")


def _unfit(job: _Job[Any, Any]) -> str | None:
    """Return why this process cannot do the job, to follow its address; None if it can."""
    for name, wanted in job.versions:
        if (found := version(name)) != wanted:
            return f"has {name} {found}, not {wanted}: install the same versions everywhere"
    if not job.shared.is_dir():
        return f"does not see {job.shared.parent} as this computer does: mount the library there at the same place"
    if not os.access(job.shared.parent, os.W_OK):
        return f"may not write to {job.shared.parent}: mount the library there writable"
    return None


def _work(job: _Job[Task, Outcome], task: Task) -> Outcome:
    """In a worker: the outcome of a task."""
    outcome: Outcome = _prepared(job)(task)
    return outcome


@lru_cache(1)
def _prepared(job: _Job[Task, Outcome]) -> Callable[[Task], Outcome]:
    """Return the function that does the tasks of a job in this worker, with one thread."""
    if (words := _unfit(job)) is not None:  # it may have come after the others were checked
        raise ClusterError(f"a worker that came later {words}")
    configure_cache()
    import numba
    from threadpoolctl import threadpool_limits

    numba.set_num_threads(1)
    work = job.setup()
    threadpool_limits(1)
    return work


def _outcome(future: Future) -> Any:
    """Return what became of a task that ended."""
    from distributed import KilledWorker

    if future.status == "finished":
        return future.result()
    if future.status != "error":
        raise CancelledError
    error = future.exception()
    if isinstance(error, KilledWorker):
        times = error.allowed_failures + 1
        return Unfinished(
            f"the worker that had it died {times} times (at last {error.last_worker.address}): try it alone"
        )
    if isinstance(error, DeviceError | HostError):
        return Unfinished(str(error))
    return Unfinished(f"the worker that had it failed ({type(error).__name__}: {error}): try it alone")


@contextmanager
def _lost_is_said() -> Iterator[None]:
    """Context in which the loss of the scheduler becomes one sentence."""
    try:
        yield
    except (CancelledError, OSError) as error:
        raise ClusterError(
            "the cluster's scheduler was lost: what is done is kept; start it again and name the other scans"
        ) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Context without dask's log and its warnings; what matters of them is said in a sentence."""
    logger = logging.getLogger("distributed")
    before = logger.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
