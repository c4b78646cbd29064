from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from device.bundle_publishing import locked_directory
from device.bundle_store import RESERVE_BYTES, BundleStore
from device.calibration_bundle import CalibrationBundle
from device.errors import FrameNotProven, NoCalibration, RecordError, StoreError
from device.scan_bundle import ScanBundle, ScanRecord
from device.store_location import default_store
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
    assert [identity.counter for identity in seen] == [1, 2, 3, 4, 5, 6]
    assert len({identity.id for identity in seen}) == 6
    assert {identity.device_id for identity in seen} == {store.device_id}
    assert seen[0].id == f"{store.device_id}-aaaaaaaa-000001"
    assert seen[1].id.endswith("-cal")


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


def test_a_read_only_disk_is_told_and_what_is_there_can_be_read(
    store: BundleStore, publish_scan: PublishScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = publish_scan(store)

    def refuse(*arguments: object, **named: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", refuse)
        with pytest.raises(StoreError, match=r"Read-only file system.*mount it"):
            store.next_identity("scans")
    assert store.scans().bundles == (bundle,)


def test_errors_of_the_capture_are_not_taken_for_the_disk(
    store: BundleStore, scan_record: Callable[..., ScanRecord]
) -> None:
    def write(directory: Path) -> None:
        raise FrameNotProven("no frame")

    with pytest.raises(FrameNotProven):
        store.publish_scan(scan_record(store), write)
    assert everything(store.root / "scans") == set()


def test_an_invalid_record_or_a_missing_file_is_never_published(
    store: BundleStore, scan_record: Callable[..., ScanRecord]
) -> None:
    record = scan_record(store)
    with pytest.raises(RecordError, match="not among files"):
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


def test_scans_left_keeps_a_reserve(store: BundleStore, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = type("Usage", (), {"free": RESERVE_BYTES + 10_500})
    monkeypatch.setattr("device.bundle_store.shutil.disk_usage", lambda _: usage)
    assert store.scans_left(1_000) == 10
    usage.free = RESERVE_BYTES - 1
    assert store.scans_left(1_000) == 0


def test_a_damaged_device_file_is_named(store: BundleStore) -> None:
    (store.root / "device.json").write_text(json.dumps({"schema": "retrograph.device/1", "device_id": 7}))
    with pytest.raises(RecordError, match=r"device\.json: "):
        BundleStore(store.root, VirtualClock())


def test_a_store_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="cannot be prepared"):
        BundleStore(tmp_path / "file", VirtualClock())


def test_the_default_store(tmp_path: Path) -> None:
    data = {"XDG_DATA_HOME": str(tmp_path / "data")}
    assert default_store(data, service_store=tmp_path) == tmp_path
    assert default_store(data, service_store=tmp_path / "absent") == tmp_path / "data" / "retroscan"
    assert default_store({}, service_store=tmp_path / "absent").parts[-3:] == (".local", "share", "retroscan")
