"""Power cuts on a real ext4: every block write of a publishing store is recorded, then replayed up to any of them.

A crash point keeps what was flushed before it and a random part of what was written since, as a disk's cache does.
Then the file system is mounted, its journal runs, the store starts, and every scan that was acknowledged must be there.
Wants root, loop devices, mkfs.ext4 and qemu-storage-daemon (Debian: qemu-system-common), see `make test-deps`.
"""

from __future__ import annotations

import os
import select
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from device.bundle_store import BundleStore
from device.errors import RecordError
from device.scan_bundle import ScanBundle
from hal.clock import VirtualClock

TOOLS = ("qemu-storage-daemon", "mkfs.ext4", "losetup", "mount", "umount")
MISSING = [tool for tool in TOOLS if shutil.which(tool) is None]
SECTOR = 512
FLUSH, FUA, DISCARD = 1, 2, 4
DISK_BYTES = 16 << 20

pytestmark = [
    pytest.mark.skipif(os.geteuid() != 0, reason="mounting wants root"),
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}; see `make test-deps`"),
    pytest.mark.skipif(not Path("/dev/fuse").exists(), reason="this kernel has no FUSE"),
    pytest.mark.skipif(not Path("/dev/loop-control").exists(), reason="this kernel has no loop devices"),
]


@dataclass(frozen=True)
class Write:
    """One entry of the log: where its bytes go on the disk, where they lie in the log, and its flags."""

    at: int
    log_at: int
    size: int
    flags: int


@dataclass(frozen=True)
class Recording:
    """The disk before, what was written to it, and after how many entries each scan was acknowledged."""

    before: Path
    log: Path
    writes: list[Write]
    acknowledged: dict[str, int]


def run(*command: str | Path) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@contextmanager
def mounted(image: Path, place: Path) -> Iterator[Path]:
    place.mkdir(exist_ok=True)
    run("mount", "-o", "loop,noatime", image, place)
    try:
        yield place
    finally:
        run("umount", place)


@contextmanager
def recorded(image: Path, log: Path, export: Path) -> Iterator[Path]:
    """The image as a file whose writes are logged."""
    export.touch()
    log.touch()
    pid = export.with_suffix(".pid")
    run(
        "qemu-storage-daemon", "--daemonize", "--pidfile", pid,
        "--blockdev", f"driver=file,node-name=disk,filename={image}",
        "--blockdev", f"driver=file,node-name=log,filename={log}",
        "--blockdev", "driver=blklogwrites,node-name=both,file=disk,log=log,"
        "log-sector-size=512,log-super-update-interval=1",
        "--export", f"type=fuse,id=export,node-name=both,mountpoint={export},writable=on",
    )  # fmt: skip
    try:
        yield export
    finally:
        daemon = int(pid.read_text())
        handle = os.pidfd_open(daemon)
        os.kill(daemon, 15)
        select.select([handle], [], [], 30.0)  # readable when it is gone
        os.close(handle)


def logged_entries(log: Path) -> int:
    with log.open("rb") as stream:
        return int(struct.unpack("<QQQI", stream.read(28))[2])


def read_log(log: Path) -> list[Write]:
    writes, at = [], SECTOR
    with log.open("rb") as stream:
        for _ in range(logged_entries(log)):
            stream.seek(at)
            sector, sectors, flags, _ = struct.unpack("<QQQQ", stream.read(32))
            size = 0 if flags & DISCARD else sectors * SECTOR
            writes.append(Write(sector * SECTOR, at + SECTOR, size, flags))
            at += SECTOR + size
    return writes


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory when there is one: the disks are simulated, so nothing is gained by waiting for a real one."""
    memory = Path("/dev/shm")  # noqa: S108
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as name:
        yield Path(name)


@pytest.fixture
def record(folder: Path, publish_scan: Callable[..., ScanBundle]) -> Callable[[int], Recording]:
    def publish_all(scans: int) -> Recording:
        image, before, log = (folder / name for name in ("disk", "before", "log"))
        with image.open("wb") as stream:
            stream.truncate(DISK_BYTES)
        run("mkfs.ext4", "-q", "-E", "lazy_itable_init=0,lazy_journal_init=0", "-J", "size=4", "-m", "0", image)
        shutil.copyfile(image, before)
        acknowledged = {}
        with recorded(image, log, folder / "export") as export, mounted(export, folder / "mnt") as place:
            store = BundleStore(place / "store", VirtualClock(), boot_id="b0071d00")
            for _ in range(scans):
                scan = publish_scan(store)
                acknowledged[scan.scan_id] = logged_entries(log)
        return Recording(before, log, read_log(log), acknowledged)

    return publish_all


def crash_images(recording: Recording, points: list[int], image: Path, rng: np.random.Generator) -> Iterator[int]:
    """Makes the disk of each crash point in turn, in ascending order; yields the point."""
    safe = image.with_suffix(".safe")
    shutil.copyfile(recording.before, safe)
    done = 0
    for point in sorted(points):
        flushes = [i + 1 for i in range(done, point) if recording.writes[i].flags & FLUSH]
        flushed = flushes[-1] if flushes else done
        apply(recording, range(done, flushed), safe)
        done = flushed
        shutil.copyfile(safe, image)
        unsafe = range(flushed, point)
        kept = [i for i in unsafe if recording.writes[i].flags & FUA or rng.random() < 0.5]
        apply(recording, kept, image)
        yield point


def apply(recording: Recording, entries: range | list[int], image: Path) -> None:
    with recording.log.open("rb") as log, image.open("r+b") as disk:
        for i in entries:
            write = recording.writes[i]
            log.seek(write.log_at)
            disk.seek(write.at)
            disk.write(log.read(write.size))


def lost_scans(recording: Recording, points: int, folder: Path, publish_scan: Callable[..., ScanBundle]) -> list[str]:
    """What is wrong after each of so many crashes, a line each."""
    rng = np.random.default_rng(5)
    first = min(recording.acknowledged.values())
    chosen = [int(at) for at in rng.integers(first, len(recording.writes) + 1, points)]
    wrong = []
    for point in crash_images(recording, chosen, folder / "crashed", rng):
        with mounted(folder / "crashed", folder / "mnt") as place:
            try:
                store = BundleStore(place / "store", VirtualClock(), boot_id="b0071d00")
            except RecordError as error:
                wrong.append(f"{point}: {error}")
                continue
            listing = store.scans()
            wrong += [f"{point}: half visible: {bundle.reason}" for bundle in listing.damaged]
            for scan in listing.bundles:
                try:
                    scan.verify()
                except RecordError as error:
                    wrong.append(f"{point}: {error}")
            present = {scan.scan_id for scan in listing.bundles}
            promised = {scan for scan, at in recording.acknowledged.items() if at <= point}
            wrong += [f"{point}: lost {scan}" for scan in sorted(promised - present)]
            wrong += [f"{point}: left {path}" for path in (store.root / "scans").glob(".*")]
            if point % 5 == 0:
                publish_scan(store).verify()  # its id was never handed out before
    return wrong


def test_acknowledged_scans_survive_power_cuts(
    record: Callable[[int], Recording], folder: Path, publish_scan: Callable[..., ScanBundle]
) -> None:
    assert lost_scans(record(10), 50, folder, publish_scan) == []


def test_without_fsync_they_would_not(
    record: Callable[[int], Recording],
    folder: Path,
    publish_scan: Callable[..., ScanBundle],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        recording = record(10)
    assert lost_scans(recording, 10, folder, publish_scan) != []


@pytest.mark.slow
def test_a_thousand_power_cuts(
    record: Callable[[int], Recording], folder: Path, publish_scan: Callable[..., ScanBundle]
) -> None:
    assert lost_scans(record(50), 1000, folder, publish_scan) == []
