"""Names, tags and notes of scans, and searches that are kept."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from device.bundles.scan import Annotations, ScanBundle, ScanRecord
from device.store.store import BundleStore
from host_sync.cli.main import main
from host_sync.errors import NoSuchBundle
from host_sync.library.labels import LABELS_FILE, label_scan
from host_sync.library.library import Library
from host_sync.viewer.catalogue import Catalogue, ListFilter


@pytest.fixture
def scans(store: BundleStore, scan_record: Callable[..., ScanRecord]) -> list[ScanBundle]:
    found = []
    for part in ("valve", "seal", "plate"):
        record = msgspec.structs.replace(scan_record(store), annotations=Annotations(part=part, operator="Ada"))
        found.append(store.publish_scan(record, lambda folder: (folder / "raw.tif").write_bytes(b"raw")))
    return found


def listed(root: Path, capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    assert main(["list", *words, "--library", str(root), "--json"]) == 0
    return [scan["scan_id"] for scan in json.loads(capsys.readouterr().out)["scans"]]


def test_labels_are_given_found_and_taken_away(
    store: BundleStore, scans: list[ScanBundle], capsys: pytest.CaptureFixture[str]
) -> None:
    root, ids = store.root, [scan.scan_id for scan in scans]
    label = ["list", "--library", str(root)]
    words = ["--set-name", "valve 3, before", "--add-tag", "worn", "reference", "--set-note", "chipped"]
    assert main([*label, "valve", *words]) == 0
    assert main([*label, ids[1], "plate", "--add-tag", "worn"]) == 0
    capsys.readouterr()
    assert listed(root, capsys, "--tag", "worn") == ids
    assert listed(root, capsys, "--tag", "ref*") == ids[:1]
    assert listed(root, capsys, "--name", "VALVE*") == ids[:1]
    assert listed(root, capsys, "chipped", "ada") == ids[:1]
    assert listed(root, capsys, "--tag", "worn", "--part", "plate") == ids[2:]
    assert main(["list", "--library", str(root)]) == 0
    head, first, *_ = capsys.readouterr().out.splitlines()
    assert head.split() == ["SCAN", "TAKEN", "VERDICT", "JOB", "PART", "GEL", "OPERATOR", "NAME", "TAGS", "NOTE"]
    assert first[head.index("NAME") :].startswith("valve 3, before")
    assert first[head.index("TAGS") :].startswith("worn,reference")
    assert main([*label, "valve", "--remove-tag", "worn", "--set-name", "", "--set-note", ""]) == 0
    assert capsys.readouterr().out.split() == [ids[0], "-", "reference", "-"]
    assert main([*label, "valve", "--remove-tag", "reference"]) == 0
    assert ids[0] not in (root / LABELS_FILE).read_text()
    assert main(["verify", "--library", str(root), "--adopt"]) == 0


def test_a_scan_is_found_by_the_name_of_its_label(store: BundleStore, scans: list[ScanBundle]) -> None:
    library, ids = Library(store.root), [scan.scan_id for scan in scans]
    label_scan(library, ids[0], name="seal")
    assert library.named("seal").scan_id == ids[0]  # before the part of that name
    assert library.named("plate").scan_id == ids[2]
    label_scan(library, ids[2], name="seal")
    with pytest.raises(NoSuchBundle, match="2 scans have the name seal: name one of"):
        library.named("seal")


def test_a_search_is_kept_and_narrowed(
    store: BundleStore, scans: list[ScanBundle], capsys: pytest.CaptureFixture[str]
) -> None:
    root, ids = store.root, [scan.scan_id for scan in scans]
    assert listed(root, capsys, "--operator", "ada", "--since", "1970-01-01", "--save", "all of Ada") == ids
    assert listed(root, capsys, "--saved", "all of Ada") == ids
    assert listed(root, capsys, "--saved", "all of Ada", "--part", "seal") == ids[1:2]
    assert main(["list", "--saved", "none", "--library", str(root)]) != 0
    assert "(all of Ada): save one with --save" in capsys.readouterr().err


def test_the_viewer_lists_scans_by_their_labels(store: BundleStore, scans: list[ScanBundle], tmp_path: Path) -> None:
    assert main(["list", "--library", str(store.root), "seal", "--add-tag", "worn", "--set-name", "old seal"]) == 0
    catalogue = Catalogue(store.root)
    listing = catalogue.list(ListFilter(words=("worn",)))
    assert [words for words in listing.complaints if scans[1].scan_id in words] != []  # found, though without heights
    assert catalogue.list(ListFilter(words=("nothing such",))).entries == ()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["valve", "--add-tag", "two words"], "without blanks"),
        (["valve", "seal", "--set-name", "both"], "a name is for one scan"),
        (["none", "--add-tag", "a"], "holds no scan"),
        (["--add-tag", "a"], "name the scans"),
    ],
)
def test_what_is_no_label_is_refused(
    words: list[str], said: str, store: BundleStore, scans: list[ScanBundle], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["list", "--library", str(store.root), *words]) != 0
    assert said in capsys.readouterr().err
    assert scans


def test_damaged_labels_are_named(
    store: BundleStore, scans: list[ScanBundle], capsys: pytest.CaptureFixture[str]
) -> None:
    (store.root / LABELS_FILE).write_text("{")
    assert main(["list", "--library", str(store.root)]) != 0
    assert "labels.json: is damaged" in capsys.readouterr().err
    assert scans
