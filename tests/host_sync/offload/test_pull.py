from __future__ import annotations

import errno
import io
import itertools
import json
import os
import shutil
import tracemalloc
from collections.abc import Callable, Generator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest

from device.bundles.calibration import CalibrationBundle
from device.bundles.record import CHUNK_BYTES, manifest_checksum
from device.bundles.scan import ScanBundle, ScanRecord
from device.io.lock import locked_directory
from device.store.store import BundleStore
from host_sync.errors import LibraryError, NoSource
from host_sync.library.library import Library
from host_sync.offload.ingest import ReceiptWriter
from host_sync.offload.pull import PullProgress, pull
from host_sync.offload.source import DirectorySource

PublishScan = Callable[..., ScanBundle]
PublishCalibration = Callable[[BundleStore], CalibrationBundle]


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(tmp_path / "library")


@pytest.fixture
def calibration(store: BundleStore, publish_calibration: PublishCalibration) -> CalibrationBundle:
    return publish_calibration(store)


@pytest.fixture
def scans(store: BundleStore, publish_scan: PublishScan, calibration: CalibrationBundle) -> list[ScanBundle]:
    return [publish_scan(store, calibration.calibration_id) for _ in range(3)]


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_everything_arrives_bit_by_bit(
    store: BundleStore, library: Library, scans: list[ScanBundle], calibration: CalibrationBundle
) -> None:
    seen: list[PullProgress] = []
    report = pull(DirectorySource(store.root), library, seen.append)
    assert report.complete
    assert report.copied == [calibration.calibration_id, *(scan.scan_id for scan in scans)]
    assert report.without_calibration == []
    assert report.copied_bytes == seen[-1].done_bytes == seen[-1].total_bytes
    for bundle in library.scans().bundles:
        assert contents(bundle.directory) == contents(store.root / "scans" / bundle.scan_id)
        assert library.calibration_for(bundle).record == calibration.record
    assert len(library.scans().bundles) == 3


def test_a_second_pull_copies_nothing(
    store: BundleStore, library: Library, scans: list[ScanBundle], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = DirectorySource(store.root)
    pull(source, library)
    opened: list[str] = []
    genuine = DirectorySource.blocks

    def noting(self: DirectorySource, place: str, offset_bytes: int = 0) -> Generator[bytes, None, None]:
        opened.append(place.rpartition("/")[2])
        return genuine(self, place, offset_bytes)

    monkeypatch.setattr(DirectorySource, "blocks", noting)
    report = pull(source, library)
    assert (report.copied, report.copied_bytes, len(report.already_there)) == ([], 0, 4)
    assert {name.removesuffix(".sha256") for name in opened} == {"scan.json", "calibration.json"}


@pytest.mark.parametrize("name", ["raw.tif", "preview.png", "scan.json", "scan.json.sha256"])
@pytest.mark.parametrize("harm", ["flip", "cut", "grow", "remove", "link"])
def test_a_damaged_bundle_is_named_and_the_others_go_on(
    store: BundleStore, library: Library, scans: list[ScanBundle], tmp_path: Path, name: str, harm: str
) -> None:
    path = scans[1].directory / name
    data = path.read_bytes()
    path.unlink()
    if harm == "link":
        (tmp_path / "elsewhere").write_bytes(data)
        path.symlink_to(tmp_path / "elsewhere")
    elif harm != "remove":
        middle = len(data) // 2
        flipped = data[:middle] + bytes([data[middle] ^ 4]) + data[middle + 1 :]
        path.write_bytes({"flip": flipped, "cut": data[:-7], "grow": data + b"\n"}[harm])
    report = pull(DirectorySource(store.root), library)
    assert [failure.bundle_id for failure in report.failed] == [scans[1].scan_id]
    assert name.removesuffix(".sha256") in report.failed[0].reason
    assert not report.complete
    assert {bundle.scan_id for bundle in library.scans().bundles} == {scans[0].scan_id, scans[2].scan_id}
    assert {path.name for path in (library.root / "scans").iterdir()} == {scans[0].scan_id, scans[2].scan_id}


def test_a_bundle_that_a_store_damages_in_writing_is_never_published(
    store: BundleStore, library: Library, scans: list[ScanBundle], monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine = os.fsync

    def rotting(descriptor: int) -> None:
        genuine(descriptor)
        written = Path(f"/proc/self/fd/{descriptor}").resolve()
        if written.name == "preview.png" and scans[0].scan_id in str(written):
            written.write_bytes(b"\0" * written.stat().st_size)

    monkeypatch.setattr(os, "fsync", rotting)
    report = pull(DirectorySource(store.root), library)
    assert [failure.bundle_id for failure in report.failed] == [scans[0].scan_id]
    assert "preview.png is damaged" in report.failed[0].reason


def test_a_full_library_stops_the_pull_without_half_a_bundle(
    store: BundleStore, library: Library, scans: list[ScanBundle], monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine, calls = os.fsync, itertools.count(1)

    def filling(descriptor: int) -> None:
        if next(calls) == 14:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        genuine(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", filling)
        with pytest.raises(LibraryError, match="No space left"):
            pull(DirectorySource(store.root), library)
    for bundle in library.scans().bundles:
        bundle.verify()
    assert list((library.root / "scans").glob(".*")) == []
    report = pull(DirectorySource(store.root), library)
    assert report.complete
    assert report.copied
    assert report.already_there


def test_a_pull_that_cannot_fit_is_refused_before_it_begins(
    store: BundleStore, library: Library, scans: list[ScanBundle], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Library, "free_bytes", lambda _: 1000)
    with pytest.raises(LibraryError, match="must be copied and 0 MB are free"):
        pull(DirectorySource(store.root), library)
    assert library.scans().bundles == ()


@pytest.mark.parametrize(
    ("name", "reason"), [("preview.png", "needs 1099512 MB"), ("raw.tif", "too many for 48x32 pixels")]
)
def test_one_bundle_of_absurd_size_holds_up_no_other(
    store: BundleStore, library: Library, scans: list[ScanBundle], name: str, reason: str
) -> None:
    manifest = scans[1].directory / "scan.json"
    record = json.loads(manifest.read_bytes())
    record["files"][name]["size"] = 1 << 40
    data = json.dumps(record).encode()
    manifest.write_bytes(data)
    (scans[1].directory / "scan.json.sha256").write_bytes(manifest_checksum("scan.json", data))
    report = pull(DirectorySource(store.root), library)
    assert [failure.bundle_id for failure in report.failed] == [scans[1].scan_id]
    assert reason in report.failed[0].reason
    assert {bundle.scan_id for bundle in library.scans().bundles} == {scans[0].scan_id, scans[2].scan_id}


def test_what_an_earlier_transfer_left_needs_no_room_again(
    store: BundleStore, library: Library, scans: list[ScanBundle], monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = [sum(entry.size for entry in scan.record.files.values()) for scan in scans]
    shutil.copytree(store.root / "calibrations", library.root / "calibrations")
    (library.root / "scans").mkdir()
    for scan in scans:
        shutil.copytree(scan.directory, library.root / "scans" / f".{scan.scan_id}.partial")
    monkeypatch.setattr(Library, "free_bytes", lambda _: min(sizes) // 2)
    assert pull(DirectorySource(store.root), library).complete


@pytest.mark.parametrize("card", ["has a bad place", "is pulled out"])
def test_a_bad_place_of_a_card_costs_one_bundle_and_a_card_that_is_gone_the_rest(
    store: BundleStore, library: Library, scans: list[ScanBundle], monkeypatch: pytest.MonkeyPatch, card: str
) -> None:
    class Failing(io.FileIO):
        def read(self, _: int | None = -1) -> bytes:
            if card == "is pulled out":
                store.root.rename(store.root.with_name("elsewhere"))
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    genuine = os.fdopen

    def opened(descriptor: int, mode: str) -> Any:
        bad = Path(f"/proc/self/fd/{descriptor}").resolve() == scans[1].directory / "raw.tif"
        return Failing(descriptor) if bad else genuine(descriptor, mode)

    source = DirectorySource(store.root)
    monkeypatch.setattr(os, "fdopen", opened)
    report = pull(source, library)
    if card == "has a bad place":
        assert [failure.bundle_id for failure in report.failed] == [scans[1].scan_id]
        assert "Input/output error" in report.failed[0].reason
        assert {bundle.scan_id for bundle in library.scans().bundles} == {scans[0].scan_id, scans[2].scan_id}
    else:
        assert "Input/output error" in (report.lost or "")
        assert [bundle.scan_id for bundle in library.scans().bundles] == [scans[0].scan_id]


def test_a_write_protected_card_gives_everything_and_takes_no_receipt(
    store: BundleStore, library: Library, scans: list[ScanBundle], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        genuine = os.open

        def opened(path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
            folder = Path(path).parent if dir_fd is None else Path(f"/proc/self/fd/{dir_fd}").resolve()
            if flags & os.O_CREAT and (folder == store.root or store.root in folder.parents):
                raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
            return genuine(path, flags, mode, dir_fd=dir_fd)

        patch.setattr(os, "open", opened)
        report = pull(DirectorySource(store.root), library, receipts=ReceiptWriter("bench", lambda: datetime.now(UTC)))
    assert report.complete
    assert "Read-only file system" in (report.unreceipted or "")


def test_a_receipt_stands_for_no_bundle_that_the_library_has_lost_part_of(
    store: BundleStore, library: Library, scans: list[ScanBundle]
) -> None:
    vouch = ReceiptWriter("bench", lambda: datetime(2026, 11, 21, tzinfo=UTC))
    assert pull(DirectorySource(store.root), library, receipts=vouch).unreceipted is None
    library.find(scans[0].scan_id).path("raw.tif").write_bytes(b"rot")
    report = pull(DirectorySource(store.root), library, receipts=vouch)
    assert [failure.bundle_id for failure in report.failed] == [scans[0].scan_id]
    assert report.here == 3


def test_another_bundle_under_the_same_id_is_never_overwritten(
    store: BundleStore, library: Library, scans: list[ScanBundle]
) -> None:
    pull(DirectorySource(store.root), library)
    kept = library.root / "scans" / scans[0].scan_id
    (kept / "scan.json").write_bytes(b"mine")
    report = pull(DirectorySource(store.root), library)
    assert [failure.bundle_id for failure in report.failed] == [scans[0].scan_id]
    assert "another bundle under this id" in report.failed[0].reason
    assert (kept / "scan.json").read_bytes() == b"mine"


def test_a_renamed_bundle_is_not_taken_for_another(
    store: BundleStore, library: Library, scans: list[ScanBundle]
) -> None:
    shutil.copytree(scans[0].directory, store.root / "scans" / "copy-of-it")
    report = pull(DirectorySource(store.root), library)
    assert [failure.bundle_id for failure in report.failed] == ["copy-of-it"]
    assert scans[0].scan_id in report.failed[0].reason


def test_what_the_library_has_is_not_fetched_again_and_not_linked(
    store: BundleStore, library: Library, tmp_path: Path, scan_record: Callable[..., ScanRecord]
) -> None:
    def publish() -> ScanBundle:
        return store.publish_scan(scan_record(store), lambda folder: (folder / "raw.tif").write_bytes(b"same") and None)

    first = publish()
    assert pull(DirectorySource(store.root), library).copied_bytes == 4
    second = publish()
    report = pull(DirectorySource(store.root), library)
    assert (report.copied, report.copied_bytes) == ([second.scan_id], 0)
    held = library.find(first.scan_id).path("raw.tif")
    held.write_bytes(b"rot!")
    library.find(second.scan_id).verify()
    third = publish()
    report = pull(DirectorySource(store.root), library)
    assert [failure.bundle_id for failure in report.failed] == [first.scan_id]
    assert report.copied == [third.scan_id]
    library.find(third.scan_id).verify()


def test_a_scan_without_its_calibration_is_reported(
    store: BundleStore, library: Library, scans: list[ScanBundle], calibration: CalibrationBundle
) -> None:
    shutil.rmtree(calibration.directory)
    report = pull(DirectorySource(store.root), library)
    assert report.without_calibration == [scan.scan_id for scan in scans]


def test_leftovers_are_cleared_and_two_pulls_do_not_mix(
    store: BundleStore, library: Library, scans: list[ScanBundle]
) -> None:
    leftover = library.root / "scans" / f".{scans[0].scan_id}.partial"
    leftover.mkdir(parents=True)
    (leftover / "raw.tif").write_bytes(b"half")
    (leftover / "stranger.part").write_bytes(b"half")
    with locked_directory(library.root), pytest.raises(LibraryError, match="another program"):
        pull(DirectorySource(store.root), library)
    assert pull(DirectorySource(store.root), library).complete
    assert not leftover.exists()


def test_memory_does_not_grow_with_the_files(
    store: BundleStore, library: Library, scan_record: Callable[..., ScanRecord]
) -> None:
    def write(directory: Path) -> None:
        with (directory / "raw.tif").open("wb") as stream:
            for _ in range(24):
                stream.write(os.urandom(CHUNK_BYTES))

    store.publish_scan(msgspec.structs.replace(scan_record(store), shape=(3000, 4000)), write)
    tracemalloc.start()
    try:
        assert pull(DirectorySource(store.root), library).complete
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 6 * CHUNK_BYTES


def test_the_store_is_found_on_a_card(store: BundleStore, tmp_path: Path, scans: list[ScanBundle]) -> None:
    card = tmp_path / "card"
    (card / "var" / "lib").mkdir(parents=True)
    shutil.copytree(store.root, card / "var" / "lib" / "retroscan")
    assert DirectorySource(card).root == card / "var" / "lib" / "retroscan"
    shutil.copytree(store.root, card / "backup")
    with pytest.raises(NoSource, match="several stores"):
        DirectorySource(card)


def test_a_place_without_scans_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "empty").mkdir()
    for name, sentence in (("file", "Not a directory"), ("absent", "No such file"), ("empty", "holds no scans")):
        with pytest.raises(NoSource, match=sentence):
            DirectorySource(tmp_path / name)
