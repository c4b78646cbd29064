"""By default there are no more processes than scans, cores and memory are good for."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from host_sync.batch.library_batch import default_workers, usable_cores, usable_memory, worker_bytes

LARGE = (3040, 4056)
GB = 10**9


@pytest.mark.parametrize(
    ("scans", "cores", "memory", "workers"),
    [
        (3, 8, None, 1),
        (8, 8, None, 2),
        (100, 8, None, 8),
        (100, 8, 100 * GB, 8),
        (100, 8, 6 * GB, 2),  # 1.7 GB each, and as much for the process that starts them
        (100, 8, 2 * GB, 1),
        (100, 8, 0, 1),
        (0, 8, 6 * GB, 1),
    ],
)
def test_scans_cores_and_memory_bound_the_number(scans: int, cores: int, memory: int | None, workers: int) -> None:
    assert default_workers([LARGE] * scans, cores, memory) == workers


def test_the_largest_frame_counts() -> None:
    small = [(380, 508)] * 100
    assert default_workers(small, 8, 6 * GB) == 8
    assert default_workers([*small, LARGE], 8, 6 * GB) == 2


@pytest.mark.parametrize(
    ("shape", "measured_mb"), [((380, 508), 396), ((1088, 1456), 487), ((1944, 2592), 919), (LARGE, 1673)]
)
def test_the_rule_holds_the_peaks_that_the_benchmark_measured(shape: tuple[int, int], measured_mb: int) -> None:
    """Of docs/performance.md; the rule may not take half as much again."""
    assert measured_mb <= worker_bytes(shape) / 1e6 <= 1.5 * measured_mb


def kernel_files(folder: Path, available_kb: int, group: str = "/") -> tuple[Path, Path]:
    """A computer's /proc and control groups, without a bound on any group."""
    proc, cgroups = folder / "proc", folder / "cgroup"
    (proc / "self").mkdir(parents=True)
    (proc / "meminfo").write_text(
        f"MemTotal:       24000000 kB\nMemAvailable:   {available_kb} kB\nHugePages_Total: 0\n"
    )
    (proc / "self" / "cgroup").write_text(f"1:name=systemd:/old\n0::{group}\n")
    (cgroups / group.strip("/")).mkdir(parents=True)
    return proc, cgroups


def bound(group: Path, limit: str, current: int, inactive_file: int) -> None:
    (group / "memory.max").write_text(f"{limit}\n")
    (group / "memory.current").write_text(f"{current}\n")
    (group / "memory.stat").write_text(f"anon 1\ninactive_file {inactive_file}\n")


def test_memory_is_what_the_kernel_says_is_available(tmp_path: Path) -> None:
    proc, cgroups = kernel_files(tmp_path, 2_000_000)
    assert usable_memory(proc, cgroups) == 2_048_000_000
    bound(cgroups, "max", 7, 3)
    assert usable_memory(proc, cgroups) == 2_048_000_000


def test_the_group_of_a_service_and_those_above_it_bound_the_memory(tmp_path: Path) -> None:
    proc, cgroups = kernel_files(tmp_path, 2_000_000, "/user.slice/watch.service")
    bound(cgroups / "user.slice", "900000000", 500_000_000, 100_000_000)
    assert usable_memory(proc, cgroups) == 500_000_000
    bound(cgroups / "user.slice" / "watch.service", "300000000", 250_000_000, 0)
    assert usable_memory(proc, cgroups) == 50_000_000
    bound(cgroups / "user.slice" / "watch.service", "300000000", 350_000_000, 0)
    assert usable_memory(proc, cgroups) == 0


def test_a_system_that_does_not_say_bounds_nothing(tmp_path: Path) -> None:
    assert usable_memory(tmp_path / "absent", tmp_path) is None


@pytest.mark.skipif(sys.platform != "linux", reason="the system does not confine processes to cores")
def test_cores_that_this_process_may_not_use_do_not_count() -> None:
    allowed = os.sched_getaffinity(0)
    assert usable_cores() == len(allowed)
    try:
        os.sched_setaffinity(0, {min(allowed)})
        assert usable_cores() == 1
    finally:
        os.sched_setaffinity(0, allowed)
