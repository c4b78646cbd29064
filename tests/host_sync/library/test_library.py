from __future__ import annotations

import resource
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from datetime import date
from pathlib import Path
from typing import Any

import msgspec
import pytest

from device.bundles.calibration import CalibrationBundle
from device.bundles.scan import Annotations, ScanBundle, ScanRecord, VerdictRecord
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.cli.main import main
from host_sync.errors import LibraryError, MissingCalibration, NoSuchBundle
from host_sync.library.index import INDEX_FILE, Query, files_by_hash, search
from host_sync.library.library import Library
from host_sync.library.verification import verify_library

PublishScan = Callable[..., ScanBundle]


@pytest.fixture
def library(store: BundleStore) -> Library:
    """A store has a library's folders, so that it serves as one."""
    return Library(store.root)


def test_a_scan_answers_to_a_unique_beginning_or_end(
    store: BundleStore, library: Library, publish_scan: PublishScan
) -> None:
    first, second = publish_scan(store), publish_scan(store)
    assert library.find(first.scan_id) == first
    assert library.find(second.scan_id[-2:]) == second
    assert library.find(first.scan_id[: len(first.scan_id)]) == first
    with pytest.raises(NoSuchBundle, match=r"the id of 2 scans, give more of it: .*000001, .*000002"):
        library.find(first.scan_id[:4])
    for absent in ("zzz", "", "../scans"):
        with pytest.raises(NoSuchBundle, match="holds no scan"):
            library.find(absent)


def test_the_calibration_in_force_at_the_press_is_found(
    store: BundleStore,
    library: Library,
    publish_scan: PublishScan,
    publish_calibration: Callable[[BundleStore], CalibrationBundle],
) -> None:
    calibration = publish_calibration(store)
    scan = publish_scan(store, calibration.calibration_id)
    assert library.calibration_for(scan) == calibration
    assert library.find_calibration(calibration.calibration_id[:-1]) == calibration
    with pytest.raises(MissingCalibration, match="without a calibration"):
        library.calibration_for(publish_scan(store))
    with pytest.raises(MissingCalibration, match="needs calibration gone-1-cal"):
        library.calibration_for(publish_scan(store, "gone-1-cal"))


def test_results_stand_beside_the_scan_and_disturb_nothing(
    store: BundleStore, library: Library, publish_scan: PublishScan
) -> None:
    scan = publish_scan(store)
    folder = library.result_folder(scan, "0.1.0", "c0ffee")
    assert folder == scan.directory / "results" / "0.1.0-c0ffee"
    assert library.results(scan) == ()
    folder.mkdir(parents=True)
    assert library.results(scan) == (folder,)
    library.find(scan.scan_id).verify()
    with pytest.raises(LibraryError, match="cannot name a folder"):
        library.result_folder(scan, "0.1.0", "../../up")


def test_an_absent_library_is_reported(tmp_path: Path) -> None:
    with pytest.raises(LibraryError, match="there is no library"):
        Library(tmp_path / "absent").scans()


def annotated(scan_record: Callable[..., ScanRecord], store: BundleStore, **facts: str) -> None:
    verdict = VerdictRecord(level=facts.pop("verdict", "good"), reason="-")  # type: ignore[arg-type]
    record = msgspec.structs.replace(scan_record(store), verdict=verdict, annotations=Annotations(**facts))
    store.publish_scan(record, lambda directory: (directory / "raw.tif").write_bytes(b"raw") and None)


def test_scans_are_found_by_what_is_said_about_them(
    tmp_path: Path, library: Library, scan_record: Callable[..., ScanRecord]
) -> None:
    store = BundleStore(library.root, VirtualClock(wall_start_s=86400.0 * 365), boot_id="b0071d00")
    annotated(scan_record, store, job="Turbine 7", part="blade-1")
    annotated(scan_record, store, job="turbine 8", part="blade-2", verdict="retake")
    annotated(scan_record, store, part="'; DROP TABLE bundle; --")

    def parts(**wanted: Any) -> list[str | None]:
        return [hit.part for hit in search(library, Query(**wanted))]

    assert parts() == ["blade-1", "blade-2", "'; DROP TABLE bundle; --"]
    assert parts(job="turbine*") == ["blade-1", "blade-2"]
    assert parts(part="BLADE-?", verdict="retake") == ["blade-2"]
    assert parts(part="'; drop*") == ["'; DROP TABLE bundle; --"]
    assert parts(gel="twin-gel", device=store.device_id[:4] + "*") == parts()
    assert parts(since=date(1971, 1, 1), until=date(1971, 1, 1)) == parts()
    assert parts(until=date(1970, 12, 31)) == []


def test_a_scan_that_was_taken_again_is_shown_as_replaced(
    library: Library, scan_record: Callable[..., ScanRecord], capsys: pytest.CaptureFixture[str]
) -> None:
    store = BundleStore(library.root, VirtualClock(wall_start_s=86400.0 * 365), boot_id="b0071d00")
    annotated(scan_record, store, part="lid-1")
    (old,) = search(library, Query())
    record = msgspec.structs.replace(scan_record(store), replaces=old.scan_id)
    new = store.publish_scan(record, lambda directory: (directory / "raw.tif").write_bytes(b"raw") and None)
    assert [hit.replaced_by for hit in search(library, Query())] == [new.scan_id, None]
    assert [hit.scan_id for hit in search(library, Query(text="replaced"))] == [old.scan_id]
    assert main(["list", "--library", str(library.root)]) == 0
    assert "good (replaced)" in capsys.readouterr().out
    shutil.rmtree(new.directory)
    assert [hit.replaced_by for hit in search(library, Query())] == [None]


def test_the_index_follows_the_folders_and_can_be_thrown_away(
    store: BundleStore, library: Library, publish_scan: PublishScan
) -> None:
    scans = [publish_scan(store) for _ in range(3)]
    path = library.root / INDEX_FILE

    def found() -> list[str]:
        return [hit.scan_id for hit in search(library, Query())]

    assert found() == [scan.scan_id for scan in scans]
    shutil.rmtree(scans[0].directory)
    (scans[1].directory / "scan.json").write_bytes(b"{}")
    fourth = publish_scan(store)
    assert found() == [scans[2].scan_id, fourth.scan_id]
    for harm in (b"", b"no database", path.read_bytes()[: path.stat().st_size // 2], None):
        path.unlink() if harm is None else path.write_bytes(harm)
        assert found() == [scans[2].scan_id, fourth.scan_id]
    with closing(sqlite3.connect(path)) as index:
        index.execute("PRAGMA user_version = 99")
        index.commit()
    assert found() == [scans[2].scan_id, fourth.scan_id]
    assert set(files_by_hash(library).values()) >= {fourth.path("raw.tif"), scans[2].path("raw.tif")}


def test_an_index_that_cannot_be_written_is_held_in_memory(
    store: BundleStore, library: Library, publish_scan: PublishScan
) -> None:
    scan = publish_scan(store)
    (library.root / INDEX_FILE).mkdir()
    assert [hit.scan_id for hit in search(library, Query())] == [scan.scan_id]


def test_an_index_for_which_there_is_no_room_is_held_in_memory(
    store: BundleStore, library: Library, publish_scan: PublishScan
) -> None:
    scans = [publish_scan(store) for _ in range(40)]
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16_384, before[1]))
    try:
        found = [hit.scan_id for hit in search(library, Query())]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert found == [scan.scan_id for scan in scans]


def test_what_a_record_says_never_moves_the_terminal(
    store: BundleStore,
    library: Library,
    scan_record: Callable[..., ScanRecord],
    capsys: pytest.CaptureFixture[str],
) -> None:
    annotated(scan_record, store, job="\x1b]0;owned\x07\x1b[2J", part="a\nb\u202ec µ")
    assert main(["list", "--library", str(library.root)]) == 0
    said = capsys.readouterr().out
    assert r"\x1b]0;owned\x07\x1b[2J  a\nb\u202ec µ" in said
    assert said.count("\n") == 2  # a header and the scan


def test_verifying_names_rot_copies_strangers_and_what_is_unfinished(
    store: BundleStore, library: Library, publish_scan: PublishScan
) -> None:
    scans = [publish_scan(store) for _ in range(4)]
    assert verify_library(library).sound == 4
    data = bytearray(scans[1].path("preview.png").read_bytes())
    data[77] ^= 1
    scans[1].path("preview.png").write_bytes(data)
    shutil.copytree(scans[2].directory, library.root / "scans" / "a-copy")
    (scans[3].directory / "notes.txt").write_text("mine")
    (library.root / "scans" / ".x-1.partial").mkdir()
    found = verify_library(library)
    assert found.sound == 3
    assert {bundle.directory.name for bundle in found.damaged} == {scans[1].scan_id, "a-copy"}
    assert any("preview.png is damaged" in bundle.reason for bundle in found.damaged)
    assert found.unlisted_files == (scans[3].directory / "notes.txt",)
    assert [path.name for path in found.unfinished] == [".x-1.partial"]
    assert main(["verify", "--library", str(library.root)]) == 1


def test_searching_from_the_command_line(
    store: BundleStore, library: Library, publish_scan: PublishScan, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = publish_scan(store)
    assert main(["list", "--job", "j-*", "--since", "1970-01-01", "--library", str(library.root)]) == 0
    assert scan.scan_id in capsys.readouterr().out
    assert main(["list", "--job", "other", "--library", str(library.root)]) == 0
    assert main(["list", "--since", "2026-02-01", "--until", "2026-01-01", "--library", str(library.root)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert f"{library.root}: no scan matches" in printed.err
    assert main(["list", "--library", str(library.root / "absent")]) == 2
