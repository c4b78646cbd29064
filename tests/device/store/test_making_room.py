"""What a press removes to make room: scans with a receipt first, then deleted ones, and no more than needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from device.bundles.bundle import Receipt
from device.bundles.record import encode_record, sha256_bytes
from device.bundles.scan import ScanBundle
from device.errors import RecordError
from device.io.lock import locked_directory
from device.store.deletion import DELETED, delete_scan, purge_deleted, purge_oldest, restore_scan
from device.store.store import RESERVE_BYTES, BundleStore
from hal.clock import VirtualClock

PublishScan = Callable[..., ScanBundle]

SCAN_BYTES = 1000


class Disk:
    """A disk that is as full as there are scans, deleted ones too."""

    def __init__(self, root: Path, scans: int) -> None:
        self.root, self.scans = root, scans

    def __call__(self, _: Path) -> Any:
        held = sum(1 for kind in ("scans", DELETED) for _ in (self.root / kind).glob("*rg*"))
        free = RESERVE_BYTES + SCAN_BYTES * (self.scans - held)
        return SimpleNamespace(
            f_flag=0, f_files=1000, f_favail=1000, f_frsize=1, f_blocks=1 << 42, f_bfree=free, f_bavail=free
        )


def full_store(root: Path, publish_scan: PublishScan, scans: int) -> tuple[BundleStore, list[ScanBundle]]:
    """A store of so many scans, oldest first, whose ids do not sort by age, with no room for another."""
    published = []
    for boot_id in ("ffff0000", "0000ffff"):
        store = BundleStore(root, VirtualClock(), boot_id=boot_id)
        published += [publish_scan(store) for _ in range(scans // 2)]
    return BundleStore(root, VirtualClock(), "b0071d00", statvfs=Disk(root, scans)), published


def receipt_for(store: BundleStore, scan: ScanBundle) -> None:
    manifest = sha256_bytes((scan.directory / "scan.json").read_bytes())
    receipt = Receipt("scans", scan.scan_id, manifest, "bench", store.wall_time())
    (store.root / "receipts" / f"{scan.scan_id}.json").write_bytes(encode_record(receipt))


def deleted(store: BundleStore) -> set[str]:
    return {path.name for path in (store.root / DELETED).iterdir()}


def test_deleted_scans_go_after_those_with_a_receipt_and_one_at_a_time(
    tmp_path: Path, publish_scan: PublishScan
) -> None:
    store, scans = full_store(tmp_path / "store", publish_scan, 6)
    ids = [scan.scan_id for scan in scans]
    receipt_for(store, scans[5])
    for name in (ids[4], ids[0], ids[2]):
        delete_scan(store.root, name)
    assert store.scans_left(SCAN_BYTES) == 0
    assert store.make_room(SCAN_BYTES) == [ids[5]]
    assert deleted(store) == {ids[0], ids[2], ids[4]}
    assert store.make_room(2 * SCAN_BYTES) == []
    assert deleted(store) == {ids[2], ids[4]}
    assert {scan.scan_id for scan in store.scans().bundles} == {ids[1], ids[3]}


def test_no_deleted_scan_goes_where_all_would_not_be_enough(tmp_path: Path, publish_scan: PublishScan) -> None:
    store, scans = full_store(tmp_path / "store", publish_scan, 4)
    receipt_for(store, scans[3])
    delete_scan(store.root, scans[0].scan_id)
    assert store.make_room(1 << 40) == [scans[3].scan_id]
    assert deleted(store) == {scans[0].scan_id}
    restore_scan(store.root, scans[0].scan_id)


def test_what_a_press_would_free_is_counted_and_stays(tmp_path: Path, publish_scan: PublishScan) -> None:
    store, scans = full_store(tmp_path / "store", publish_scan, 4)
    assert store.scans_left_after_removal(SCAN_BYTES) == 0
    receipt_for(store, scans[3])
    with_receipt = store.scans_left_after_removal(100)
    delete_scan(store.root, scans[0].scan_id)
    assert 0 < with_receipt < store.scans_left_after_removal(100)
    assert deleted(store) == {scans[0].scan_id}
    assert len(store.scans().bundles) == 3


def test_a_power_cut_while_purging_leaves_no_half_scan_to_bring_back(
    store: BundleStore, publish_scan: PublishScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan = publish_scan(store)
    delete_scan(store.root, scan.scan_id)
    with monkeypatch.context() as patch:
        patch.setattr("device.store.deletion.remove_tree_quietly", lambda _: None)
        purge_oldest(store.root, lambda: False)
    with pytest.raises(RecordError, match="no longer there"):
        restore_scan(store.root, scan.scan_id)
    purge_deleted(store.root)
    assert deleted(store) == set()


def test_a_purge_waits_for_the_stores_lock(
    store: BundleStore, publish_scan: PublishScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    delete_scan(store.root, publish_scan(store).scan_id)
    genuine, held = Path.rename, []

    def looked_at(path: Path, target: Path) -> Path:
        try:
            with locked_directory(store.root, wait=False):
                held.append(False)
        except BlockingIOError:
            held.append(True)
        return genuine(path, target)

    monkeypatch.setattr(Path, "rename", looked_at)
    purge_deleted(store.root)
    assert held == [True]
    assert deleted(store) == set()
