"""Every call into the system fails once in turn, while a store publishes and frees, and a library pulls and searches.

After each fault: what was acknowledged is whole, nothing half is visible, and the next run repairs. The faults come
from a library that is loaded before Python starts, so the tests below run in a process of their own.
"""

from __future__ import annotations

import ctypes
import errno
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest

from device.bundles.bundle import receipted_bundle
from device.bundles.scan import ScanBundle
from device.errors import DeviceError
from device.io.atomic import atomic_directory
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.errors import HostError
from host_sync.library.index import Query, search
from host_sync.library.library import Library
from host_sync.library.verification import verify_library
from host_sync.offload.ingest import ReceiptWriter
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource

SHIM = Path(__file__).parents[2] / "apparatus" / "io_faults.c"
ROOT = Path(__file__).parents[3]
INSIDE = "RETROGRAPH_IO_FAULTS"
SHORT_WRITE = -1
FAULTS = (errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.EINTR, SHORT_WRITE)
MAX_CALLS = 5000

inside = pytest.mark.skipif(INSIDE not in os.environ, reason="runs in a process of its own, which another test starts")


def run_inside(tmp_path: Path, stride: int) -> None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler is installed: `make test-deps`")
    shim = tmp_path / "io_faults.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", shim, SHIM, "-ldl"], check=True)
    environment = os.environ | {"LD_PRELOAD": str(shim), INSIDE: str(stride)}
    command = [sys.executable, "-m", "pytest", "-q", "-rP", "-p", "no:cacheprovider", str(Path(__file__))]
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-5000:]
    assert "6 passed" in run.stdout, run.stdout[-1000:]
    print(*re.findall(r"\d+ faults.*", run.stdout), sep="\n")  # noqa: T201


@pytest.mark.skipif(INSIDE in os.environ, reason="starts the process")
def test_some_faults(tmp_path: Path) -> None:
    run_inside(tmp_path, 13)


@pytest.mark.slow
def test_every_fault(tmp_path: Path) -> None:
    run_inside(tmp_path, 1)


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder in memory: thousands of trials wait for no disk."""
    memory = Path("/dev/shm")  # noqa: S108
    with tempfile.TemporaryDirectory(dir=memory if os.access(memory, os.W_OK) else None) as name:
        yield Path(name)


def each_fault(prepare: Callable[[], object], work: Callable[[], object], check: Callable[[], None]) -> None:
    """Does the work again and again, each time with another fault, and checks what is left."""
    shim = ctypes.CDLL(None)
    prepare()
    work()  # what is imported late is imported now
    stride = int(os.environ[INSIDE])
    tried = 0
    for index, fault in enumerate(FAULTS):
        for nth in range(1 + index * stride // len(FAULTS), MAX_CALLS, stride):
            prepare()
            shim.io_faults_arm(nth, fault)
            try:
                with suppress(DeviceError, HostError):
                    work()
            finally:
                calls = shim.io_faults_disarm()
            check()
            tried += 1
            if calls < nth:
                break
        else:
            pytest.fail(f"more than {MAX_CALLS} calls")
    assert tried > len(FAULTS)
    print(f"{tried} faults, nothing lost")  # noqa: T201


def whole(store: BundleStore) -> set[str]:
    """Ids of the scans, each proven; a damaged one fails the test."""
    listing = store.scans()
    assert listing.damaged == ()
    for scan in listing.bundles:
        scan.verify()
    return {scan.scan_id for scan in listing.bundles}


def again(root: Path) -> BundleStore:
    return BundleStore(root, VirtualClock(), boot_id="b0071d01")


@inside
def test_publishing(place: Path, publish_scan: Callable[..., ScanBundle]) -> None:
    acknowledged: set[str] = set()
    counter = 0

    def prepare() -> None:
        nonlocal counter
        counter += 1
        if counter % 50 == 0:
            shutil.rmtree(place / "store")
            acknowledged.clear()

    def work() -> None:
        acknowledged.add(publish_scan(BundleStore(place / "store", VirtualClock(), f"b{counter}")).scan_id)

    def check() -> None:
        store = again(place / "store")
        assert acknowledged == whole(store)
        assert list((store.root / "scans").glob(".*")) == []

    each_fault(prepare, work, check)


@inside
def test_freeing(place: Path, publish_scan: Callable[..., ScanBundle]) -> None:
    kept = BundleStore(place / "kept", VirtualClock(), "b0071d00")
    for _ in range(2):
        publish_scan(kept)
    pull(DirectorySource(kept.root), Library(place / "library"), receipts=receipts())
    unreceipted = publish_scan(kept).scan_id
    everything = whole(kept)

    def prepare() -> None:
        shutil.rmtree(place / "store", ignore_errors=True)
        shutil.copytree(kept.root, place / "store")

    def check() -> None:
        left = whole(again(place / "store"))
        assert unreceipted in left
        assert left <= everything
        assert list((place / "store" / "scans").glob(".*")) == []

    each_fault(prepare, lambda: again(place / "store").make_room(1 << 60), check)


def receipts() -> ReceiptWriter:
    return ReceiptWriter("bench", lambda: datetime(2026, 11, 22, tzinfo=UTC))


@inside
def test_pulling(place: Path, publish_scan: Callable[..., ScanBundle]) -> None:
    card = BundleStore(place / "card", VirtualClock(), "b0071d00")
    scans = {publish_scan(card).scan_id for _ in range(2)}

    def prepare() -> None:
        shutil.rmtree(place / "library", ignore_errors=True)
        shutil.rmtree(card.root / "receipts")
        (card.root / "receipts").mkdir()

    def work() -> None:
        pull(DirectorySource(card.root), Library(place / "library"), receipts=receipts())

    def check() -> None:
        library = Library(place / "library")
        if library.root.is_dir():
            here = library.scans()
            assert here.damaged == ()
            for scan in here.bundles:
                scan.verify()
            receipted = {receipted_bundle(path.name) for path in (card.root / "receipts").glob("*.json")}
            assert receipted <= {scan.scan_id for scan in here.bundles}
        assert pull(DirectorySource(card.root), library, receipts=receipts()).complete
        found = verify_library(Library(library.root))
        assert (found.complete, found.sound, found.unrecorded) == (True, len(scans), ())
        assert whole(card) == scans

    each_fault(prepare, work, check)


@inside
@pytest.mark.parametrize("reading", ["search", "verify"])
def test_reading_a_library(place: Path, publish_scan: Callable[..., ScanBundle], reading: str) -> None:
    card = BundleStore(place / "card", VirtualClock(), "b0071d00")
    scans = {publish_scan(card).scan_id for _ in range(2)}
    library = Library(place / "library")
    pull(DirectorySource(card.root), library)

    def work() -> None:
        if reading == "search":
            search(Library(library.root), Query())
        else:
            verify_library(Library(library.root))

    def check() -> None:
        assert {hit.scan_id for hit in search(Library(library.root), Query())} == scans
        assert verify_library(Library(library.root)).complete

    each_fault(lambda: (library.root / "index.sqlite3").unlink(missing_ok=True), work, check)


@inside
def test_replacing_results(place: Path) -> None:
    target = place / "results"

    def written(number: int) -> None:
        with atomic_directory(target, "result.json") as folder:
            for name in ("heights", "result.json"):
                (folder / name).write_bytes(bytes([number]) * 10_000)

    def contents() -> set[bytes]:
        return {path.read_bytes() for path in target.iterdir()}

    def check() -> None:
        replaced = target.with_name(".results.replaced")
        if not target.exists():  # between its two renames: the next run begins with putting it back
            replaced.rename(target)
        assert contents() in ({bytes([1]) * 10_000}, {bytes([2]) * 10_000})
        written(3)
        assert contents() == {bytes([3]) * 10_000}
        assert [path.name for path in place.iterdir()] == ["results"]

    each_fault(lambda: written(1), lambda: written(2), check)
