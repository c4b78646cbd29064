"""What a library has taken in is never forgotten: loss, change and unrecorded are told apart, and can be repaired."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from device.bundles.calibration import CalibrationBundle
from device.bundles.scan import ScanBundle, read_scan
from device.store.store import BundleStore
from host_sync.cli.main import main
from host_sync.errors import HostError, SourceError
from host_sync.library.index import INDEX_FILE
from host_sync.library.intake import HEAD_FILE, INTAKE_FILE, list_set_aside, read_intake
from host_sync.library.library import Library
from host_sync.library.verification import adopt, verify_library
from host_sync.offload.mirror import SftpPlace, mirror_to_folder, repair
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource

SCANS = 4


@pytest.fixture(autouse=True)
def without_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.fixture
def card(
    store: BundleStore,
    publish_scan: Callable[..., ScanBundle],
    publish_calibration: Callable[[BundleStore], CalibrationBundle],
) -> DirectorySource:
    calibration = publish_calibration(store)
    for _ in range(SCANS):
        publish_scan(store, calibration.calibration_id)
    return DirectorySource(store.root)


@pytest.fixture
def library(card: DirectorySource, tmp_path: Path) -> Library:
    found = Library(tmp_path / "library")
    assert pull(card, found).complete
    return found


def reopened(library: Library) -> Library:
    return Library(library.root)


def scans(library: Library) -> list[ScanBundle]:
    return list(library.scans().bundles)


def test_every_single_loss_and_change_is_noticed(library: Library, tmp_path: Path) -> None:
    """A thousand trials: one file or folder of the library is removed, cut, or has one bit changed."""
    kept = tmp_path / "kept"
    shutil.copytree(library.root, kept)
    files = sorted(path for path in library.root.rglob("*") if path.is_file() and path.name != INDEX_FILE)
    folders = sorted(path for path in library.root.glob("*/*") if path.is_dir())
    rng = np.random.default_rng(3)
    noticed = 0
    for trial in range(1000):
        harm = ("remove", "flip", "cut", "remove the folder of")[trial % 4]
        path = folders[rng.integers(len(folders))] if harm.startswith("remove the") else files[rng.integers(len(files))]
        data = b"" if path.is_dir() else path.read_bytes()
        if path.is_dir():
            shutil.rmtree(path)
        elif harm == "remove":
            path.unlink()
        elif harm == "flip":
            at, bit = int(rng.integers(len(data))), 1 << int(rng.integers(8))
            path.chmod(0o644)
            path.write_bytes(data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :])
        else:
            path.chmod(0o644)
            path.write_bytes(data[: int(rng.integers(len(data)))])
        found = verify_library(reopened(library))
        noticed += not found.complete
        back = kept / path.relative_to(library.root)
        shutil.copytree(back, path) if back.is_dir() else shutil.copy2(back, path)
    assert noticed == 1000
    assert verify_library(reopened(library)).complete


def test_loss_change_and_strangers_are_distinguished(library: Library, card: DirectorySource) -> None:
    first, second, third, fourth = scans(library)
    shutil.rmtree(first.directory)
    second.path("raw.tif").chmod(0o644)
    second.path("raw.tif").write_bytes(b"rot")
    record = (library.root / INTAKE_FILE).read_bytes()
    (library.root / INTAKE_FILE).write_bytes(record.replace(fourth.scan_id.encode(), b"rg-of-somebody-else"))
    assert verify_library(reopened(library)).record_fault is not None
    (library.root / INTAKE_FILE).write_bytes(record)
    stranger = library.root / "scans" / "rg-stranger-1"
    shutil.copytree(third.directory, stranger)
    found = verify_library(reopened(library))
    assert [bundle.directory for bundle in found.lost] == [first.directory]
    assert {bundle.directory for bundle in found.damaged} == {second.directory, stranger}
    assert "is lost (taken in from" in found.lost[0].reason
    assert found.sound == SCANS - 2 + 1
    assert found.total == SCANS + 2


def test_a_whole_bundle_that_was_never_taken_in_is_a_stranger_until_it_is_adopted(
    library: Library, store: BundleStore, publish_scan: Callable[..., ScanBundle]
) -> None:
    planted = publish_scan(store)
    shutil.copytree(planted.directory, library.root / "scans" / planted.scan_id)
    found = verify_library(reopened(library))
    assert found.complete
    assert [path.name for path in found.unrecorded] == [planted.scan_id]
    assert adopt(library, found) == 1
    assert verify_library(reopened(library)).unrecorded == ()
    shutil.rmtree(library.root / "scans" / planted.scan_id)
    assert len(verify_library(reopened(library)).lost) == 1


def test_a_library_of_an_older_release_is_adopted_as_it_is(library: Library) -> None:
    for name in (INTAKE_FILE, HEAD_FILE):
        (library.root / name).unlink()
    old = reopened(library)
    found = verify_library(old)
    assert (found.complete, found.unrecorded) == (True, ())
    assert main(["verify", "--adopt", "--library", str(library.root)]) == 0
    assert len(read_intake(library.root).held) == SCANS + 1


@pytest.mark.parametrize("harm", ["a line is removed", "lines change places", "the end is cut off", "it is removed"])
def test_the_record_cannot_be_shortened_or_rewritten_unnoticed(library: Library, harm: str) -> None:
    path = library.root / INTAKE_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    match harm:
        case "a line is removed":
            path.write_bytes(b"".join(lines[:1] + lines[2:]))
        case "lines change places":
            path.write_bytes(b"".join([lines[1], lines[0], *lines[2:]]))
        case "the end is cut off":
            path.write_bytes(b"".join(lines[:-1]))
        case _:
            path.unlink()
    found = verify_library(reopened(library))
    assert not found.complete
    assert str(path) in (found.record_fault or "")
    assert main(["verify", "--library", str(library.root)]) == 1
    assert main(["verify", "--adopt", "--library", str(library.root)]) == 1
    assert main(["verify", "--library", str(library.root)]) == 0
    assert len(read_intake(library.root).held) == SCANS + 1
    kept = list((library.root / "set-aside" / "intake").glob("1-*"))
    assert len(kept) == (1 if harm == "it is removed" else 2)


def test_a_line_that_a_power_cut_left_unfinished_is_dropped(
    library: Library, store: BundleStore, card: DirectorySource, publish_scan: Callable[..., ScanBundle]
) -> None:
    path = library.root / INTAKE_FILE
    with path.open("ab") as stream:
        stream.write(b'{"schema":"retrograph.inta')
    assert verify_library(reopened(library)).complete
    publish_scan(store)
    assert pull(card, reopened(library)).complete
    found = read_intake(library.root)
    assert (found.fault, found.count) == (None, SCANS + 2)


def test_verified_scans_are_read_only(library: Library) -> None:
    for bundle in library.bundles().bundles:
        for path in bundle.directory.iterdir():
            assert path.stat().st_mode & 0o222 == 0


def test_a_partial_verification_comes_round(library: Library) -> None:
    library.find(scans(library)[2].scan_id).path("preview.png").chmod(0o644)
    scans(library)[2].path("preview.png").write_bytes(b"rot")
    hashed, rounds = 0, []
    for _ in range(SCANS + 1):
        found = verify_library(reopened(library), fraction=0.05)
        assert found.skipped == SCANS
        hashed += found.sound
        rounds.append(len(found.damaged))
    assert hashed == SCANS
    assert sum(rounds) == 1
    assert main(["verify", "--partial", "100 %", "--library", str(library.root)]) == 1
    assert main(["verify", "--partial", "0%", "--library", str(library.root)]) == 2


def test_what_is_lost_or_damaged_is_repaired_and_results_stay(library: Library, card: DirectorySource) -> None:
    first, second, third, _ = scans(library)
    shutil.rmtree(first.directory)
    second.path("raw.tif").chmod(0o644)
    second.path("raw.tif").write_bytes(b"rot")
    results = second.directory / "results" / "0.1.0-c0ffee"
    results.mkdir(parents=True)
    (results / "result.json").write_bytes(b"{}")
    report = repair(reopened(library), [card])
    assert set(report.repaired) == {first.scan_id, second.scan_id}
    assert report.failed == ()
    assert verify_library(reopened(library)).complete
    assert (results / "result.json").read_bytes() == b"{}"
    (entry,) = list_set_aside(library.root)
    assert entry.why.name == second.scan_id
    assert "raw.tif has 3 bytes" in entry.why.reason
    assert entry.folder is not None
    assert (entry.folder / "raw.tif").read_bytes() == b"rot"
    third.path("raw.tif").unlink()
    assert main(["verify", "--repair", "--library", str(library.root)]) == 2
    assert main(["verify", "--repair", str(card.root), "--library", str(library.root)]) == 0


def test_a_source_with_another_scan_under_the_id_repairs_nothing(
    library: Library, card: DirectorySource, tmp_path: Path
) -> None:
    first, second, *_ = scans(library)
    forged = tmp_path / "forged"
    shutil.copytree(card.root, forged)
    shutil.rmtree(forged / "scans" / first.scan_id)
    shutil.rmtree(first.directory)
    shutil.copytree(forged / "scans" / second.scan_id, forged / "scans" / first.scan_id)
    report = repair(reopened(library), [DirectorySource(forged)])
    assert report.repaired == ()
    assert [failure.bundle_id for failure in report.failed] == [first.scan_id]
    assert not first.directory.exists()


def test_a_mirror_gets_what_it_lacks_and_repairs_the_library(library: Library, tmp_path: Path) -> None:
    copy = tmp_path / "mirror"
    arguments = ["verify", "--library", str(library.root), "--mirror", str(copy)]
    assert main(arguments) == 0
    assert verify_library(Library(copy)).sound == SCANS + 1
    again = mirror_to_folder(library, copy, lambda _: None)
    assert (again.copied, len(again.already_there)) == ((), SCANS + 1)
    shutil.rmtree(scans(library)[0].directory)
    assert main(["verify", "--repair", str(copy), "--library", str(library.root)]) == 0
    assert verify_library(reopened(library)).complete
    rotten = read_scan(scans(Library(copy))[1].directory).path("raw.tif")
    rotten.chmod(0o644)
    rotten.write_bytes(rotten.read_bytes()[:-1] + b"x")
    assert [failure.bundle_id for failure in mirror_to_folder(library, copy, lambda _: None, verify=True).failed] == [
        rotten.parent.name
    ]
    with pytest.raises(HostError, match="is the library itself"):
        mirror_to_folder(library, library.root, lambda _: None)
    with pytest.raises(HostError, match="or inside it"):
        mirror_to_folder(library, library.root / "copy", lambda _: None)


def test_an_address_of_a_mirror_is_read_or_refused() -> None:
    assert SftpPlace.parse("sftp://me@nas:2222/backup/scans/") == SftpPlace("me", "nas", 2222, "/backup/scans")
    assert SftpPlace.parse("sftp://[fe80::1]/x") == SftpPlace(None, "fe80::1", 22, "/x")
    assert SftpPlace.parse("/media/disk") is None
    for text in ("sftp://", "sftp://nas", "sftp://nas:port/x", "sftp://a b@nas"):
        with pytest.raises((HostError, SourceError), match="is no address"):
            SftpPlace.parse(text)


def test_a_scan_that_the_user_removed_is_forgotten_when_he_says_so(library: Library) -> None:
    first, second, *_ = scans(library)
    shutil.rmtree(first.directory)
    assert main(["verify", "--forget", first.scan_id, "--library", str(library.root)]) == 0
    assert verify_library(reopened(library)).complete
    assert main(["verify", "--forget", second.scan_id, "--library", str(library.root)]) == 2
    assert main(["verify", "--forget", "nobody", "--library", str(library.root)]) == 2


def test_a_forged_receipt_frees_nothing_and_hides_nothing(
    library: Library, card: DirectorySource, store: BundleStore, publish_scan: Callable[..., ScanBundle]
) -> None:
    """A file of the right name is no receipt, and one for a calibration does not cover a scan."""
    scan = publish_scan(store)
    receipts = store.root / "receipts"
    (receipts / f"{scan.scan_id}.json").write_bytes(b"{}")
    assert store.make_room(1 << 60) == []
    assert pull(card, library).copied == [scan.scan_id]
