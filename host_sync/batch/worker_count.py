"""Default number of processes that reconstruct at a time: bounded by scans, cores and memory."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

SCANS_A_WORKER: Final = 4
"""A process more takes a second to start: it is worth that for so many scans."""

BYTES_A_WORKER: Final = 400_000_000
"""What a process takes for libraries and compiled code, before any frame."""

BYTES_A_PIXEL: Final = 105
"""What it takes besides for each pixel: 25 arrays of float32, and the raw frame."""

PROC: Final = Path("/proc")
CGROUPS: Final = Path("/sys/fs/cgroup")


def default_workers(shapes: Sequence[tuple[int, int]], cores: int, memory: int | None) -> int:
    """Processes for scans of these shapes, at least 1.

    As many as there are cores, at most one for every `SCANS_A_WORKER` scans, and as many as fit into the memory with
    the process that starts them, which makes calibrations of the same frames meanwhile.

    shapes : (H, W) of every scan's frame, px; the largest counts
    memory : bytes that may be taken; None where the system does not say
    """
    wanted = min(cores, len(shapes) // SCANS_A_WORKER)
    if memory is not None and shapes:
        wanted = min(wanted, memory // max(map(worker_bytes, shapes)) - 1)
    return max(wanted, 1)


def worker_bytes(shape: tuple[int, int]) -> int:
    """Peak memory of a process that reconstructs frames of (H, W) pixels."""
    return BYTES_A_WORKER + BYTES_A_PIXEL * shape[0] * shape[1]


def usable_cores() -> int:
    """Cores that this process may run on: fewer than the computer's where a service or container is confined."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def usable_memory(proc: Path = PROC, cgroups: Path = CGROUPS) -> int | None:
    """Bytes that this process and its children can take: what is available on the computer, less where a service or
    container is confined. None where the system does not say.
    """
    bounds = [*_available(proc), *_left_in_groups(proc, cgroups)]
    return max(min(bounds), 0) if bounds else None


def _available(proc: Path) -> Iterator[int]:
    """Return what the kernel says is available, files' pages that it can drop among it."""
    found = _figures(proc / "meminfo").get("MemAvailable:")
    if found is not None:
        yield 1024 * found


def _left_in_groups(proc: Path, cgroups: Path) -> Iterator[int]:
    """Return what each control group (version 2) that holds this process has left; none where no group is bounded."""
    try:
        own = next(line[3:] for line in (proc / "self" / "cgroup").read_text().splitlines() if line.startswith("0::"))
    except (OSError, StopIteration):
        return
    place = cgroups / own.strip("/")
    for group in (place, *place.parents):
        limit, taken = _number(group / "memory.max"), _number(group / "memory.current")
        if limit is not None and taken is not None:
            yield limit - taken + _figures(group / "memory.stat").get("inactive_file", 0)
        if group == cgroups:
            return


def _figures(path: Path) -> dict[str, int]:
    """Names and numbers of a file with one of each in a line."""
    try:
        lines = [line.split() for line in path.read_text().splitlines()]
    except OSError:
        return {}
    return {words[0]: int(words[1]) for words in lines if len(words) > 1 and words[1].isdecimal()}


def _number(path: Path) -> int | None:
    """The number in a file; None where there is none, as in one that says "max"."""
    try:
        text = path.read_text().strip()
    except OSError:
        return None
    return int(text) if text.isdecimal() else None
