"""Power cuts on a real ext4: every block write of a publishing store is recorded, then replayed up to any of them.

Then the file system is mounted, the store starts, and every scan that was acknowledged must be there.
Wants root, loop devices, mkfs.ext4 and qemu-storage-daemon (Debian: qemu-system-common), see `make test-deps`.
"""

from __future__ import annotations

import os
import select
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from crash_disk import TOOLS, Recording, logged_entries, lost_scans, mounted, read_log, run

from device.bundles.scan import ScanBundle
from device.store.store import BundleStore
from hal.clock import VirtualClock

MISSING = [tool for tool in ("qemu-storage-daemon", *TOOLS) if shutil.which(tool) is None]
DISK_BYTES = 16 << 20

pytestmark = [
    pytest.mark.skipif(os.geteuid() != 0, reason="mounting wants root"),
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}; see `make test-deps`"),
    pytest.mark.skipif(not Path("/dev/fuse").exists(), reason="this kernel has no FUSE"),
    pytest.mark.skipif(not Path("/dev/loop-control").exists(), reason="this kernel has no loop devices"),
]


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
