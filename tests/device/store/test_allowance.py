"""Whoever holds a workstation's key can fill the shared folders, and it costs no scan its place."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from device.bundles.bundle import Receipt, receipt_name
from device.bundles.record import encode_record, sha256_bytes
from device.bundles.scan import ScanBundle
from device.store import store as store_module
from device.store.store import BundleStore


def size_of(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*"))


@pytest.fixture
def scan(store: BundleStore, publish_scan: Callable[..., ScanBundle]) -> ScanBundle:
    """A scan with an honest receipt."""
    scan = publish_scan(store)
    receipt = Receipt(
        kind="scans",
        bundle_id=scan.scan_id,
        manifest_sha256=sha256_bytes((scan.directory / "scan.json").read_bytes()),
        host="bench",
        verified=store.wall_time(),
    )
    (store.root / "receipts" / receipt_name(scan.scan_id)).write_bytes(encode_record(receipt))
    return scan


def test_what_floods_the_receipts_is_removed_and_receipts_stay(
    store: BundleStore, scan: ScanBundle, publish_scan: Callable[..., ScanBundle], tmp_path: Path
) -> None:
    other = publish_scan(store)
    receipts = store.root / "receipts"
    for number in range(3000):
        (receipts / f"rg00-b-{number:06d}.json").write_bytes(b"{}")
    (receipts / ".growing.part").write_bytes(bytes(5 << 20))
    (receipts / receipt_name(other.scan_id)).write_bytes(bytes(1 << 20))
    (receipts / "folder").mkdir()
    (receipts / "folder" / "deep").mkdir()
    (receipts / "folder" / "deep" / "file").write_bytes(bytes(1 << 20))
    secret = tmp_path / "secret"
    secret.write_bytes(b"mine")
    (receipts / "link.json").symlink_to(secret)
    (receipts / "linked").symlink_to(tmp_path)
    os.mkfifo(receipts / "pipe.json")
    assert store.make_room(1) == []
    assert [path.name for path in receipts.iterdir()] == [receipt_name(scan.scan_id)]
    assert secret.read_bytes() == b"mine"
    assert store.make_room(1 << 60) == [scan.scan_id]


def test_an_inbox_beyond_its_limits_loses_the_largest_and_keeps_what_was_pushed(
    store: BundleStore, scan: ScanBundle, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(store_module, "MAX_INBOX_BYTES", 4 << 20)
    inbox = store.root / "inbox"
    (inbox / "pushed").mkdir()
    (inbox / "pushed" / "model.npz").write_bytes(bytes(1 << 20))
    (inbox / "flood").mkdir()
    for number in range(8):
        (inbox / "flood" / f"{number}").write_bytes(bytes(1 << 20))
    (inbox / "large").write_bytes(bytes(6 << 20))
    (inbox / "linked").symlink_to(tmp_path)
    store.make_room(1)
    assert sorted(path.name for path in inbox.iterdir()) == ["linked", "pushed"]
    assert size_of(inbox) <= 4 << 20
    for number in range(100):
        (inbox / f"empty-{number}").mkdir()
    store.make_room(1)
    assert len(list(inbox.iterdir())) == store_module.MAX_INBOX_ENTRIES
    assert scan.directory.is_dir()


def test_within_the_limits_nothing_is_removed(store: BundleStore, scan: ScanBundle) -> None:
    (store.root / "inbox" / "pushed").mkdir()
    before = sorted(path.name for path in store.root.rglob("*"))
    store.make_room(1)
    assert sorted(path.name for path in store.root.rglob("*")) == before


def test_shared_folders_that_are_links_are_left_alone(store: BundleStore, scan: ScanBundle, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "file").write_bytes(b"mine")
    inbox = store.root / "inbox"
    inbox.rmdir()
    inbox.symlink_to(outside)
    store.make_room(1)
    assert (outside / "file").read_bytes() == b"mine"
