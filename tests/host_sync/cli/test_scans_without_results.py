"""Commands over a library in which one scan has no results, one has damaged ones, or which is empty."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mosaic_presses import grid_places, press_of_map, pressed, rough_target, write_press

from device.bundles.scan import ScanBundle
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.cli.main import main
from host_sync.library.library import Library
from host_sync.mosaic.presses import MOSAIC_FILE
from host_sync.mosaic.writing import MosaicRecord
from host_sync.results.files import HEIGHT_FILE, RECORD_FILE
from host_sync.results.record import encode_record

SHAPE = (136, 182)


@pytest.fixture
def scans(tmp_path: Path, publish_scan: Callable[..., ScanBundle]) -> list[ScanBundle]:
    """Overlapping presses in a library; the last one has no results."""
    random = np.random.default_rng(4)
    target = rough_target((330, 430))
    store = BundleStore(tmp_path / "library", VirtualClock(start_ns=5_000), boot_id="b0071d00")
    found = []
    for place in grid_places(2, 2, (95.0, 127.0), random):
        scan = publish_scan(store)
        found.append(scan)
        if len(found) == 4:
            break
        folder = write_press(press_of_map("now", pressed(target, place, SHAPE, random)), scan.directory / "results")
        record = msgspec.structs.replace(press_of_map("now", np.zeros(SHAPE)).record, scan_id=scan.scan_id)
        (folder / RECORD_FILE).write_bytes(encode_record(record))
    return found


@pytest.fixture
def library(tmp_path: Path, scans: list[ScanBundle]) -> Path:
    return tmp_path / "library"


def damage(scan: ScanBundle, name: str) -> None:
    """Cut a file of the scan's results in half."""
    path = Library(scan.directory.parents[1]).newest_result(scan) / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def mosaic_of(library: Path, out: Path) -> MosaicRecord:
    assert main(["mosaic", "--library", str(library), "--out", str(out)]) == 1
    return msgspec.json.decode((out / MOSAIC_FILE).read_bytes(), type=MosaicRecord)


def test_a_mosaic_leaves_out_a_scan_without_results_and_names_it(
    library: Path, scans: list[ScanBundle], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = mosaic_of(library, tmp_path / "whole")
    assert [place.name for place in record.presses] == [scan.scan_id for scan in scans[:3]]
    said = capsys.readouterr()
    assert said.err == f"retrosync: left out: {record.unusable[0]}\n"
    assert f"{scans[3].scan_id}: has no results: run retrosync reconstruct --library" in said.err
    assert f"DOUBTFUL: left out: {scans[3].scan_id}: has no results" in said.out


@pytest.mark.parametrize("name", [RECORD_FILE, HEIGHT_FILE])
def test_a_mosaic_leaves_out_a_damaged_result_and_names_it(
    library: Path, scans: list[ScanBundle], tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(scans[3].directory)
    damage(scans[2], name)
    layout = tmp_path / "places.csv"
    lines = [f"{scan.scan_id},{right},0" for scan, right in zip(scans[:3], (0.0, 6.1, 500.0), strict=True)]
    layout.write_text("\n".join(["scan,right_mm,down_mm", *lines]), encoding="utf-8")
    for given in ([], ["--layout", str(layout)]):
        out = tmp_path / f"whole-{len(given)}"
        assert main(["mosaic", "--library", str(library), "--out", str(out), "--json", *given]) == 1
        said = capsys.readouterr()
        record = msgspec.json.decode(said.out, type=MosaicRecord)
        assert [place.name for place in record.presses] == [scan.scan_id for scan in scans[:2]]
        assert len(record.unusable) == 1
        assert str(scans[2].directory / "results" / "now" / name) in said.err


def test_a_mosaic_without_two_usable_scans_is_refused(
    library: Path, scans: list[ScanBundle], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(scans[0], RECORD_FILE)
    damage(scans[1], HEIGHT_FILE)
    assert main(["mosaic", "--library", str(library), "--out", str(tmp_path / "whole")]) == 2
    words = capsys.readouterr().err
    assert "a mosaic needs two presses or more; left out: " in words
    assert words.count("\n") == 1
    assert all(scan.scan_id in words for scan in (scans[0], scans[1], scans[3]))
    assert not (tmp_path / "whole").exists()


def test_the_same_spot_says_which_scan_cannot_be_compared(
    library: Path, scans: list[ScanBundle], capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["compare", scans[0].scan_id, "--library", str(library)]
    assert main([*given, scans[3].scan_id]) == 2
    assert (
        f"has no results: run retrosync reconstruct --library {library} {scans[3].scan_id}" in capsys.readouterr().err
    )
    damage(scans[1], HEIGHT_FILE)
    assert main([*given, scans[1].scan_id]) == 2
    assert str(scans[1].directory / "results" / "now" / HEIGHT_FILE) in capsys.readouterr().err


def test_a_population_is_reported_without_what_cannot_be_measured(
    library: Path, scans: list[ScanBundle], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "report"
    given = ["report", "--library", str(library), "--population", "--no-pdf", "--out", str(out)]
    damage(scans[2], HEIGHT_FILE)
    assert main(given) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 2
    assert f"{scans[3].scan_id}: has no results" in said
    assert str(scans[2].directory) in said
    assert sorted(path.name for path in out.iterdir()) == ["numbers.csv", "population.html"]
    damage(scans[1], RECORD_FILE)
    assert main([*given[:-1], str(tmp_path / "other")]) == 2
    assert "a population is two results or more" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_a_search_names_what_was_not_compared(
    library: Path, scans: list[ScanBundle], capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["list", "--like", scans[0].scan_id, "--library", str(library)]
    damage(scans[2], HEIGHT_FILE)
    for _ in range(2):  # a damaged result is named each time
        assert main([*given, "--json"]) == 1
        said = capsys.readouterr()
        answer = json.loads(said.out)
        assert [one["scan"] for one in answer["found"]] == [scans[1].scan_id]
        assert answer["without_results"] == [scans[3].scan_id]
        assert answer["unreadable"][0][0] == scans[2].scan_id
        assert f"not compared: {scans[2].scan_id}: " in said.err
        assert f"without results: {scans[3].scan_id}: run retrosync reconstruct --library {library}\n" in said.err
    shutil.rmtree(scans[2].directory)
    shutil.rmtree(scans[3].directory)
    assert main(given) == 0
    assert main(["list", "--like", scans[1].scan_id, "--library", str(library)]) == 0


def test_an_empty_library_ends_in_a_sentence(
    library: Path, scans: list[ScanBundle], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    for given in (
        ["mosaic", "--out", str(tmp_path / "out")],
        ["compare", "a", "b"],
        ["report", "--population", "--out", str(tmp_path / "out")],
        ["list", "--like", "a"],
        ["list", "--like", str(scans[0].directory / "results" / "now")],
    ):
        assert main([*given, "--library", str(empty)]) == 2, given
        said = capsys.readouterr()
        assert said.err.count("\n") == 1, given
        assert str(empty) in said.err, given
        assert said.out == ""
    assert not (tmp_path / "out").exists()
    assert sorted(path.name for path in empty.iterdir()) == []
