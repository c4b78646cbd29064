from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from device.bundles.bundle import Receipt
from device.bundles.calibration import CalibrationBundle
from device.bundles.record import encode_record, sha256_bytes
from device.bundles.scan import ScanBundle, ScanRecord
from device.errors import FrameNotConfirmed, NoCalibration, RecordError, StoreError
from device.io.lock import locked_directory
from device.io.system import explain_os_error
from device.store.deletion import evict_acknowledged
from device.store.store import RESERVE_BYTES, BundleStore, default_store
from hal.clock import VirtualClock

PublishScan = Callable[..., ScanBundle]
PublishCalibration = Callable[[BundleStore], CalibrationBundle]


def everything(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*")}


def test_identities_never_repeat_whatever_the_clocks_say(tmp_path: Path) -> None:
    seen = []
    for boot, wall_s in (("aaaaaaaa", 1.8e9), ("bbbbbbbb", 0.0), ("bbbbbbbb", 0.0)):
        store = BundleStore(tmp_path, VirtualClock(wall_start_s=wall_s), boot_id=boot)
        seen += [store.next_identity("scans"), store.next_identity("calibrations")]
    assert [identity.counter for identity in seen] == [1, 1, 2, 2, 3, 3]
    assert len({identity.id for identity in seen}) == 6
    assert {identity.device_id for identity in seen} == {store.device_id}
    assert seen[0].id == f"{store.device_id}-aaaaaaaa-000001"
    assert seen[1].id.endswith("-cal")


def test_a_store_whose_calibrations_took_numbers_of_scans_goes_on_without_repeating_one(tmp_path: Path) -> None:
    store = BundleStore(tmp_path, VirtualClock(), boot_id="aaaaaaaa")
    for _ in range(4):
        store.next_identity("scans")
    (tmp_path / "calibration-count.json").unlink()
    found = [store.next_identity(kind).counter for kind in ("calibrations", "scans", "calibrations")]
    assert found == [5, 5, 6]


def test_bundles_are_listed_in_order_and_damaged_ones_by_name(store: BundleStore, publish_scan: PublishScan) -> None:
    first, second, third = (publish_scan(store) for _ in range(3))
    (second.directory / "scan.json").write_bytes(b"{}")
    listing = store.scans()
    assert listing.bundles == (first, third)
    assert [damaged.directory for damaged in listing.damaged] == [second.directory]
    assert "scan.json" in listing.damaged[0].reason


def test_a_taken_id_is_refused_and_the_first_bundle_stays(store: BundleStore, publish_scan: PublishScan) -> None:
    bundle = publish_scan(store)
    with pytest.raises(StoreError, match="exists already"):
        store.publish_scan(bundle.record, lambda directory: (directory / "raw.tif").write_bytes(b"other") and None)
    bundle.verify()


@pytest.mark.parametrize("call", ["fsync", "rename", "mkdir", "write", "open"])
def test_a_full_disk_at_any_step_leaves_nothing(
    tmp_path: Path,
    scan_record: Callable[..., ScanRecord],
    publish_scan: PublishScan,
    monkeypatch: pytest.MonkeyPatch,
    call: str,
) -> None:
    owner, name = {
        "fsync": (os, "fsync"),
        "rename": (Path, "rename"),
        "mkdir": (Path, "mkdir"),
        "write": (Path, "write_bytes"),
        "open": (os, "open"),
    }[call]
    genuine = getattr(owner, name)
    store = BundleStore(tmp_path / "store", VirtualClock(), boot_id="b0071d00")
    refused = 0
    for step in range(30):
        record = scan_record(store)
        before, calls = everything(store.root), 0

        def failing(*arguments: object, _step: int = step, **named: object) -> object:
            nonlocal calls
            calls += 1
            if calls == _step + 1:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return genuine(*arguments, **named)

        with monkeypatch.context() as patch:
            patch.setattr(owner, name, failing)
            try:
                store.publish_scan(record, lambda directory: (directory / "raw.tif").open("wb").close())
            except StoreError as error:
                assert "No space left" in str(error)  # noqa: PT017
                refused += 1
            else:
                assert calls <= step
                break
        assert everything(store.root) == before
    assert refused >= 1
    assert calls == refused
    publish_scan(store).verify()


def test_a_read_only_disk_is_reported_and_what_is_there_can_be_read(
    store: BundleStore, publish_scan: PublishScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = publish_scan(store)

    def refuse(*arguments: object, **named: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refuse)
        with pytest.raises(StoreError, match=r"Read-only file system.*mount it"):
            store.next_identity("scans")
    assert store.scans().bundles == (bundle,)


def test_errors_of_the_capture_are_not_taken_for_the_disk(
    store: BundleStore, scan_record: Callable[..., ScanRecord]
) -> None:
    def write(directory: Path) -> None:
        raise FrameNotConfirmed("no frame")

    with pytest.raises(FrameNotConfirmed):
        store.publish_scan(scan_record(store), write)
    assert everything(store.root / "scans") == set()


def test_an_invalid_record_or_a_missing_file_is_never_published(
    store: BundleStore, scan_record: Callable[..., ScanRecord]
) -> None:
    record = scan_record(store)
    with pytest.raises(RecordError, match=r"raw\.tif is not listed there"):
        store.publish_scan(record, lambda _: None)
    nameless = msgspec.structs.replace(record, pixel_pitch_um=float("nan"))
    with pytest.raises(RecordError, match="pixel_pitch_um"):
        store.publish_scan(nameless, lambda directory: (directory / "raw.tif").touch())
    assert everything(store.root / "scans") == set()


def test_a_start_clears_what_a_power_cut_left_and_nothing_else(store: BundleStore, publish_scan: PublishScan) -> None:
    bundle = publish_scan(store)
    left, growing = store.root / "scans" / ".a-1.partial", store.root / "scans" / ".a-2.partial"
    for directory in (left, growing):
        directory.mkdir()
        (directory / "raw.tif").write_bytes(b"half")
    (store.root / "scans" / "notes.partial").mkdir()
    with locked_directory(growing):
        again = BundleStore(store.root, VirtualClock())
    assert not left.exists()
    assert growing.exists()
    assert (store.root / "scans" / "notes.partial").exists()
    assert again.scans().bundles == (bundle,)
    assert again.device_id == store.device_id


def test_the_active_calibration_is_chosen_whole(store: BundleStore, publish_calibration: PublishCalibration) -> None:
    with pytest.raises(NoCalibration, match="run `retroscan calibrate`"):
        store.active_calibration()
    first, second = publish_calibration(store), publish_calibration(store)
    store.activate(first.calibration_id)
    assert store.active_calibration() == first
    second.path("model.npz").write_bytes(b"rot")
    with pytest.raises(RecordError, match=r"model\.npz"):
        store.activate(second.calibration_id)
    with pytest.raises(RecordError, match="no calibration id"):
        store.activate("../scans")
    assert store.active_calibration() == first
    first.directory.rename(store.root / "elsewhere")
    with pytest.raises(NoCalibration, match="is gone"):
        store.active_calibration()


def disk(free_bytes: int = 1 << 40, flags: int = 0, entries: int = 1000) -> Any:
    """What a file system says of itself."""
    return SimpleNamespace(
        f_flag=flags,
        f_files=1000,
        f_favail=entries,
        f_frsize=1,
        f_blocks=1 << 42,
        f_bfree=free_bytes,
        f_bavail=free_bytes,
    )


def test_scans_left_keeps_a_reserve(tmp_path: Path) -> None:
    found = disk(RESERVE_BYTES + 10_500)
    store = BundleStore(tmp_path / "store", VirtualClock(), "b0071d00", statvfs=lambda _: found)
    assert store.scans_left(1_000) == 10
    found.f_bavail = RESERVE_BYTES - 1
    assert store.scans_left(1_000) == 0


def test_a_press_is_refused_when_the_store_cannot_be_written(tmp_path: Path) -> None:
    store = BundleStore(tmp_path / "store", VirtualClock(), "b0071d00", statvfs=lambda _: disk(flags=os.ST_RDONLY))
    with pytest.raises(StoreError, match=r"Read-only file system.*mount it"):
        store.scans_left(1_000)


def test_a_disk_without_names_left_has_room_for_no_scan(tmp_path: Path) -> None:
    store = BundleStore(tmp_path / "store", VirtualClock(), "b0071d00", statvfs=lambda _: disk(entries=40))
    assert store.scans_left(1) == 2


@pytest.mark.parametrize("mask", [0o000, 0o002, 0o077])
def test_the_group_reads_scans_and_writes_receipts_whatever_the_mask(
    tmp_path: Path,
    publish_scan: PublishScan,
    publish_calibration: Callable[[BundleStore], CalibrationBundle],
    mask: int,
) -> None:
    before = os.umask(mask)
    try:
        store = BundleStore(tmp_path / "deep" / "store", VirtualClock(), boot_id="b0071d00")
        scan, calibration = publish_scan(store), publish_calibration(store)
        store.activate(calibration.calibration_id)
    finally:
        os.umask(before)
    modes = {path: path.stat().st_mode & 0o777 for path in (store.root, *store.root.rglob("*"))}
    shared = {store.root / "receipts", store.root / "inbox"}
    assert {modes.pop(path) for path in shared} == {0o770}
    assert {mode for path, mode in modes.items() if path.is_dir()} == {0o750}
    assert {mode for path, mode in modes.items() if path.is_file()} == {0o640}
    scan.verify()


def receipt_for(store: BundleStore, bundle: ScanBundle, manifest: bytes | None = None) -> None:
    receipt = Receipt(
        kind="scans",
        bundle_id=bundle.scan_id,
        manifest_sha256=sha256_bytes(manifest or (bundle.directory / "scan.json").read_bytes()),
        host="bench",
        verified=store.wall_time(),
    )
    (store.root / "receipts" / f"{bundle.scan_id}.json").write_bytes(encode_record(receipt))


def test_only_what_a_workstation_vouches_for_is_freed_and_the_oldest_first(
    tmp_path: Path, publish_scan: PublishScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans = []
    for boot_id in ("ffff0000", "0000ffff"):  # ids do not sort by age
        store = BundleStore(tmp_path / "store", VirtualClock(), boot_id=boot_id)
        scans += [publish_scan(store) for _ in range(3)]
    for scan in (scans[0], scans[2], scans[4]):
        receipt_for(store, scan)
    receipt_for(store, scans[1], b"another manifest")
    (store.root / "receipts" / f"{scans[3].scan_id}.json").write_bytes(b"{}")
    taken = 1000

    def statvfs(_: Path) -> Any:
        return disk(RESERVE_BYTES + taken * (6 - len(list((store.root / "scans").glob("rg*")))))

    store = BundleStore(store.root, VirtualClock(), "b0071d00", statvfs=statvfs)
    assert store.make_room(1500) == [scans[0].scan_id, scans[2].scan_id]
    assert store.make_room(10_000) == [scans[4].scan_id]
    assert {scan.scan_id for scan in store.scans().bundles} == {scans[i].scan_id for i in (1, 3, 5)}
    assert list((store.root / "scans").glob(".*")) == []


def test_a_power_cut_while_freeing_leaves_nothing_half_visible(
    store: BundleStore, publish_scan: PublishScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan = publish_scan(store)
    receipt_for(store, scan)
    monkeypatch.setattr("device.store.deletion.remove_tree_quietly", lambda _: None)
    assert evict_acknowledged(store.root, lambda: False) == [scan.scan_id]
    assert store.scans().bundles == ()
    assert store.scans().damaged == ()
    BundleStore(store.root, VirtualClock())
    assert everything(store.root / "scans") == set()


def test_a_pushed_calibration_is_proven_before_it_is_taken(
    store: BundleStore, publish_calibration: PublishCalibration, tmp_path: Path
) -> None:
    other = BundleStore(tmp_path / "other", VirtualClock(), boot_id="b0071d01")
    good, rotten, misnamed, linked = (publish_calibration(other) for _ in range(4))
    rotten.path("model.npz").write_bytes(b"rot")
    inbox = store.root / "inbox"
    for bundle in (good, rotten):
        shutil.copytree(bundle.directory, inbox / bundle.calibration_id)
    shutil.copytree(misnamed.directory, inbox / "other-name")
    (inbox / linked.calibration_id).symlink_to(linked.directory)
    deliveries = {delivery.name: delivery.refusal for delivery in store.import_inbox()}
    assert deliveries.pop(good.calibration_id) is None
    assert "model.npz" in (deliveries.pop(rotten.calibration_id) or "")
    assert misnamed.calibration_id in (deliveries.pop("other-name") or "")
    assert "is no folder" in (deliveries.pop(linked.calibration_id) or "")
    assert deliveries == {}
    assert [bundle.record for bundle in store.calibrations().bundles] == [good.record]
    store.activate(good.calibration_id)
    linked.verify()
    assert list(inbox.iterdir()) == []


def test_a_pushed_calibration_without_room_is_refused(publish_calibration: PublishCalibration, tmp_path: Path) -> None:
    store = BundleStore(tmp_path / "store", VirtualClock(), "b0071d00", statvfs=lambda _: disk(RESERVE_BYTES + 100))
    bundle = publish_calibration(BundleStore(tmp_path / "other", VirtualClock(), boot_id="b0071d01"))
    shutil.copytree(bundle.directory, store.root / "inbox" / bundle.calibration_id)
    assert "free space first" in (store.import_inbox()[0].refusal or "")
    assert store.calibrations().bundles == ()


@pytest.mark.parametrize(
    ("code", "advice"),
    [
        (errno.ENOSPC, "free space"),
        (errno.EROFS, "mount it"),
        (errno.EACCES, "let this user"),
        (errno.ENOTDIR, "name a folder"),
        (errno.EIO, "check the card"),
    ],
)
def test_advice_fits_the_refusal(code: int, advice: str) -> None:
    sentence = explain_os_error(OSError(code, os.strerror(code)))
    assert advice in sentence
    assert os.strerror(code) in sentence


def test_a_damaged_choice_of_calibration_is_not_to_be_fetched_again(store: BundleStore) -> None:
    (store.root / "active.json").write_bytes(b"{")
    with pytest.raises(RecordError, match=r"active\.json.*retroscan calibrate"):
        store.active_calibration()


def test_a_damaged_device_file_is_named(store: BundleStore) -> None:
    (store.root / "device.json").write_text(json.dumps({"schema": "retrograph.device/1", "device_id": 7}))
    with pytest.raises(RecordError, match=r"device\.json: "):
        BundleStore(store.root, VirtualClock())


def test_a_store_that_cannot_be_made_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="cannot be prepared"):
        BundleStore(tmp_path / "file", VirtualClock())


def test_the_default_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    assert default_store(tmp_path) == tmp_path
    assert default_store(tmp_path / "absent") == tmp_path / "data" / "retroscan"
    monkeypatch.delenv("XDG_DATA_HOME")
    assert default_store(tmp_path / "absent").parts[-3:] == (".local", "share", "retroscan")


def test_a_receipt_for_a_calibration_frees_no_scan(store: BundleStore, publish_scan: PublishScan) -> None:
    scan = publish_scan(store)
    manifest = (scan.directory / "scan.json").read_bytes()
    path = store.root / "receipts" / f"{scan.scan_id}.json"
    for kind, freed in (("calibrations", []), ("scans", [scan.scan_id])):
        receipt = Receipt(
            kind=kind,  # type: ignore[arg-type]
            bundle_id=scan.scan_id,
            manifest_sha256=sha256_bytes(manifest),
            host="bench",
            verified=store.wall_time(),
        )
        path.write_bytes(encode_record(receipt))
        assert store.make_room(1 << 60) == freed
