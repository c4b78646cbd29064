"""Scans of a library, reconstructed by several processes with calibrations that are made once and shared as files."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Final

import msgspec

from device.bundles.scan import ScanBundle, read_scan
from device.errors import DeviceError
from device.io.atomic import remove_tree_quietly
from device.io.lock import FolderLocked, locked_directory
from device.io.system import explain_os_error
from host_sync.batch.cluster import Unfinished, outcomes_on_cluster
from host_sync.batch.worker_pool import Lost, outcomes_of
from host_sync.errors import HostError
from host_sync.filters.form import DetailBand
from host_sync.kernels.cache import holds_kernels
from host_sync.kernels.process_settings import kept_memory
from host_sync.library.library import Library
from host_sync.results.files import DetailName

if TYPE_CHECKING:
    from distributed import Client

    from host_sync.calibration.calibrate import Method
    from host_sync.reconstruction.scans import LibraryReconstructor


class ScanOutcome(msgspec.Struct, frozen=True, omit_defaults=True):
    """A folder of results and its doubts, or the reason why there is none."""

    scan: str
    folder: Path | None = None
    warnings: tuple[str, ...] = ()
    reason: str | None = None


SCANS_A_WORKER: Final = 4
"""A process more takes a second to start: it is worth that for so many scans."""

BYTES_A_WORKER: Final = 400_000_000
"""Memory that a process takes for libraries and compiled code, before any frame."""

BYTES_A_PIXEL: Final = 105
"""Memory that each pixel takes on top: 25 arrays of float32, and the raw frame."""

PROC: Final = Path("/proc")
CGROUPS: Final = Path("/sys/fs/cgroup")


def default_workers(shapes: Sequence[tuple[int, int]], cores: int, memory: int | None) -> int:
    """Return processes for scans of these shapes, at least 1.

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
    """Return the peak memory of a process that reconstructs frames of (H, W) pixels."""
    return BYTES_A_WORKER + BYTES_A_PIXEL * shape[0] * shape[1]


def usable_cores() -> int:
    """Return the cores that this process may run on: fewer than the computer's if it is confined.

    A service or a container confines it.
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def usable_memory(proc: Path = PROC, cgroups: Path = CGROUPS) -> int | None:
    """Return the bytes of memory that this process and its children can take.

    It is what is available on the computer, or what a service or container has left if that is less. None where the
    system does not state it.
    """
    bounds = [*_available(proc), *_left_in_groups(proc, cgroups)]
    return max(min(bounds), 0) if bounds else None


def _available(proc: Path) -> Iterator[int]:
    """Yield the memory that the kernel reports as available, with files' pages that it can drop."""
    found = _figures(proc / "meminfo").get("MemAvailable:")
    if found is not None:
        yield 1024 * found


def _left_in_groups(proc: Path, cgroups: Path) -> Iterator[int]:
    """Yield the memory that each control group (version 2) that holds this process has left.

    Nothing where no group is bounded.
    """
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
    """Return names and numbers of a file with one of each in a line."""
    try:
        lines = [line.split() for line in path.read_text().splitlines()]
    except OSError:
        return {}
    return {words[0]: int(words[1]) for words in lines if len(words) > 1 and words[1].isdecimal()}


def _number(path: Path) -> int | None:
    """Return the number in a file; None where there is none, as in one that says "max"."""
    try:
        text = path.read_text().strip()
    except OSError:
        return None
    return int(text) if text.isdecimal() else None


PREFIX: Final = ".retrosync-"


@contextmanager
def work_folder(place: Path) -> Iterator[Path]:
    """A new folder in `place`, removed at the end; what killed jobs of this computer left there is removed first.

    Raises
    ------
    OSError
        None can be made there.
    """
    remove_abandoned(place)
    with ExitStack() as stack:
        yield _held_folder(place, stack)


def remove_abandoned(place: Path) -> None:
    """Remove folders of jobs of this computer that no longer run; those that cannot be removed stay.

    The lock of a job on another computer may not be seen from here, so that its folder is left alone.
    """
    for folder in place.glob(f"{_prefix()}*"):
        with suppress(OSError), locked_directory(folder, wait=False):
            remove_tree_quietly(folder)


def _held_folder(place: Path, stack: ExitStack) -> Path:
    """Return a new folder whose lock is held, and which is removed, with the stack."""
    while True:
        with ExitStack() as attempt:
            folder = Path(mkdtemp(prefix=_prefix(), dir=place))
            attempt.callback(remove_tree_quietly, folder)
            try:
                attempt.enter_context(locked_directory(folder, wait=False))
            except (FolderLocked, FileNotFoundError):
                continue  # another job that starts took it for abandoned before it was locked
            if folder.is_dir():
                stack.push(attempt.pop_all())
                return folder


def _prefix() -> str:
    """Return what the folders of this computer's jobs are called, but for the end of the name."""
    return f"{PREFIX}{re.sub('[^A-Za-z0-9]+', '_', socket.gethostname())}-"


KEPT_CALIBRATIONS: Final = 2
"""So many of the calibrations that a process read last stay in its memory."""


@dataclass(frozen=True, slots=True)
class ScanTask:
    """A scan's folder, and the file of the calibration to reconstruct it with."""

    scan: Path
    calibration: Path


def _quiet(_: str) -> None:
    """Ignore a step."""


@dataclass(frozen=True, slots=True)
class ReconstructionOptions:
    """Options of the reconstruction of a batch; a call in a process returns what reconstructs a scan there.

    root : the library's folder
    method, band, force, detail : as for `LibraryReconstructor`
    report_progress : is given a few words as each step begins, in the process
    """

    root: Path
    method: Method | None = None
    band: DetailBand | None = None
    force: bool = False
    detail: DetailName = "shrunk"
    report_progress: Callable[[str], None] = _quiet

    def __call__(self) -> Callable[[ScanTask], ScanOutcome]:
        """Return the function that reconstructs scans in this process."""
        import cv2

        from host_sync.calibration_file.calibrator import Calibrator
        from host_sync.reconstruction.scans import LibraryReconstructor

        cv2.setNumThreads(1)

        @lru_cache(KEPT_CALIBRATIONS)
        def job(calibration: Path) -> LibraryReconstructor:
            return LibraryReconstructor(
                Library(self.root),
                self.method,
                self.report_progress,
                self.band,
                force=self.force,
                detail=self.detail,
                calibrator=Calibrator.of_file(calibration),
            )

        return lambda task: _outcome(job, task)


def _outcome(job: Callable[[Path], LibraryReconstructor], task: ScanTask) -> ScanOutcome:
    try:
        return _reconstructed(job(task.calibration), read_scan(task.scan))
    except (DeviceError, HostError) as error:
        return ScanOutcome(task.scan.name, reason=str(error))


def _reconstructed(job: LibraryReconstructor, scan: ScanBundle) -> ScanOutcome:
    from host_sync.results.doubts import stated_doubts

    _, folder = job.run(scan)
    return ScanOutcome(scan.scan_id, folder, stated_doubts(folder))


def reconstruct_all(
    scans: Sequence[ScanBundle], work: ReconstructionOptions, job: LibraryReconstructor, workers: int | None = None
) -> Iterator[ScanOutcome]:
    """Reconstruct scans by so many processes; return the outcome of each, once.

    workers : by default as many as the number of scans, cores and memory allow

    work, job : of the same order; `job` does it where one process is enough
    """
    wanted = workers or default_workers([scan.record.shape for scan in scans], usable_cores(), usable_memory())
    if wanted <= 1:
        return one_by_one(scans, job)
    return reconstruct_scans(scans, work, job, min(wanted, len(scans)), first_alone=not holds_kernels())


def one_by_one(scans: Sequence[ScanBundle], job: LibraryReconstructor) -> Iterator[ScanOutcome]:
    """Reconstruct scans in this process; return the outcome of each."""
    with kept_memory():
        for scan in scans:
            try:
                yield _reconstructed(job, scan)
            except (DeviceError, HostError) as error:
                yield ScanOutcome(scan.scan_id, reason=str(error))


def reconstruct_scans(
    scans: Sequence[ScanBundle],
    work: ReconstructionOptions,
    job: LibraryReconstructor,
    workers: int,
    *,
    first_alone: bool = False,
) -> Iterator[ScanOutcome]:
    """Return what became of every scan, once, by so many processes, in the order in which they are done.

    job : makes each calibration once, in this process; scans that have none are not sent to another
    workers : processes at a time, with one thread each
    first_alone : the first scan is done before another begins: it compiles what all need
    """

    def by_processes(tasks: Iterable[ScanTask], _: Path) -> Iterator[ScanOutcome]:
        for task, outcome in outcomes_of(tasks, work, workers, first_alone=first_alone):
            yield ScanOutcome(task.scan.name, reason=outcome.reason) if isinstance(outcome, Lost) else outcome

    return _with_calibrations(scans, job, by_processes, work.root)


def reconstruct_on_cluster(
    scans: Sequence[ScanBundle], work: ReconstructionOptions, job: LibraryReconstructor, client: Client
) -> Iterator[ScanOutcome]:
    """Reconstruct scans by the workers of a dask cluster, which share the library's folder with this computer.

    Raises
    ------
    ClusterError
        The workers cannot do it, or scheduler or all workers were lost.
    """

    def by_cluster(tasks: Iterable[ScanTask], shared: Path) -> Iterator[ScanOutcome]:
        for task, outcome in outcomes_on_cluster(client, tasks, work, shared):
            yield ScanOutcome(task.scan.name, reason=outcome.reason) if isinstance(outcome, Unfinished) else outcome

    return _with_calibrations(scans, job, by_cluster, work.root)


def _with_calibrations(
    scans: Sequence[ScanBundle],
    job: LibraryReconstructor,
    run: Callable[[Iterable[ScanTask], Path], Iterator[ScanOutcome]],
    place: Path,
) -> Iterator[ScanOutcome]:
    """Return what became of every scan, with calibrations in files of a temporary folder.

    run : gets tasks, and that folder
    place : of that folder
    """
    refused: list[ScanOutcome] = []
    with ExitStack() as stack:
        try:
            folder = stack.enter_context(work_folder(place))
        except OSError as error:
            reason = f"no temporary folder for calibrations can be made in {place} {explain_os_error(error)}"
            yield from (ScanOutcome(scan.scan_id, reason=reason) for scan in scans)
            return

        def tasks() -> Iterator[ScanTask]:
            for scan in scans:
                try:
                    kept = job.calibration_of(scan)
                    path = folder / f"{kept.facts.calibration_id}.calibration"
                    if not path.exists():
                        kept.write(path)
                except (DeviceError, HostError) as error:
                    refused.append(ScanOutcome(scan.scan_id, reason=str(error)))
                else:
                    yield ScanTask(scan.directory, path)

        for outcome in run(tasks(), folder):
            yield outcome
            while refused:
                yield refused.pop(0)
        yield from refused
