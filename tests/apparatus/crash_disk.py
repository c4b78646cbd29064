"""Contents of a disk after a power cut: its recorded writes, replayed up to any of them.

The log is written by QEMU's blklogwrites driver. A crash point keeps what was flushed before it and a random half of
what was written since, like a disk cache; then the file system is mounted and its journal is replayed.
"""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from device.bundles.scan import ScanBundle
from device.errors import RecordError
from device.store.store import BundleStore
from hal.clock import VirtualClock

TOOLS = ("mkfs.ext4", "losetup", "mount", "umount")
SECTOR = 512
FLUSH, FUA, DISCARD = 1, 2, 4


@dataclass(frozen=True)
class Write:
    """One entry of the log: position of its bytes on the disk and in the log, and its flags."""

    at: int
    log_at: int
    size: int
    flags: int


@dataclass(frozen=True)
class Recording:
    """The disk before, the writes to it, and the number of entries after which each scan was acknowledged."""

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


def crash_images(recording: Recording, points: list[int], image: Path, rng: np.random.Generator) -> Iterator[int]:
    """Make the disk of each crash point in turn, in ascending order; yields the point."""
    safe = image.with_suffix(".safe")
    run("cp", "--sparse=always", recording.before, safe)
    done = 0
    for point in sorted(points):
        flushes = [i + 1 for i in range(done, point) if recording.writes[i].flags & FLUSH]
        flushed = flushes[-1] if flushes else done
        apply(recording, range(done, flushed), safe)
        done = flushed
        run("cp", "--sparse=always", safe, image)
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
    """Errors after each of this many crashes, one line each."""
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
