"""Runs a function in a new process: nothing loaded, its own thread count, its own memory peak."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

THREAD_SETTINGS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
AS_A_COMMAND: Final = MappingProxyType({"OPENBLAS_NUM_THREADS": "1"})
"""Of a process that is to run as `retrosync` does."""

Result = TypeVar("Result")


def fresh(
    function: Callable[..., Result],
    *arguments: Any,
    threads: int | None = None,
    settings: Mapping[str, str] = MappingProxyType({}),
) -> Result:
    """Result of the function, computed in a new process with this many threads (None: the default).

    settings : environment variables of it
    """
    with (
        thread_settings(threads),
        environment(settings),
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
    ):
        return pool.submit(function, *arguments).result()


def thread_settings(threads: int | None) -> AbstractContextManager[None]:
    """Processes started inside use this many threads."""
    return environment({} if threads is None else dict.fromkeys(THREAD_SETTINGS, str(threads)))


@contextmanager
def environment(settings: Mapping[str, str]) -> Iterator[None]:
    """Processes started inside have these environment variables."""
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def forget_peak() -> None:
    """Reset the measurement of this process's peak memory."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_mb() -> float:
    """Largest resident memory of this process since its start or `forget_peak`, MB."""
    return _status_mb("VmHWM")


def resident_mb() -> float:
    """Resident memory of this process now, MB."""
    return _status_mb("VmRSS")


def _status_mb(key: str) -> float:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    (value,) = (line.split()[1] for line in lines if line.startswith(f"{key}:"))
    return int(value) * 1024 / 1e6
