"""What comes into a library is reconstructed and measured, once, also when that was interrupted."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from host_sync.batch.library_batch import ScanOutcome
from host_sync.batch.library_watch import MEASUREMENTS, LibraryWatch, only_watch
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.cli.main import main
from host_sync.library.library import Library
from host_sync.measurement.recipe import Recipe
from host_sync.reconstruction.scans import LibraryReconstructor


@pytest.fixture
def watch_of(calibrator: Calibrator) -> Callable[..., LibraryWatch]:
    """Makes a watch of a library."""

    def make(library: Library, **recipe: Any) -> LibraryWatch:
        return LibraryWatch(library, LibraryReconstructor(library, calibrator=calibrator), Recipe(**recipe), 1)

    return make


def by_scan(outcomes: list[ScanOutcome]) -> dict[str, str | None]:
    assert len({one.scan for one in outcomes}) == len(outcomes)
    return {one.scan: one.reason for one in outcomes}


def test_what_a_pull_brings_is_reconstructed_and_measured_once(
    library: Library,
    watch_of: Callable[..., LibraryWatch],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    held = Library(tmp_path / "scans")
    shutil.copytree(library.root, held.root)
    first, second, damaged = (bundle.directory.name for bundle in held.scans().bundles)
    calibrations, late = tmp_path / "calibrations", tmp_path / second
    (held.root / "calibrations").rename(calibrations)
    (held.root / "scans" / second).rename(late)
    watch = watch_of(held)

    assert all("pull it from the device" in (why or "") for why in by_scan(list(watch.look())).values())
    assert list(watch.look()) == []

    calibrations.rename(held.root / "calibrations")
    found = by_scan(list(watch.look()))
    assert found[first] is None
    assert "raw.tif" in (found[damaged] or "")
    assert list(watch.look()) == []

    late.rename(held.root / "scans" / second)
    assert by_scan(list(watch.look())) == {second: None}
    measurements = held.root / MEASUREMENTS
    assert {path.name for path in measurements.iterdir()} == {f"{first}.json", f"{second}.json"}
    heights = json.loads((measurements / f"{first}.json").read_text())
    assert "Sa" in json.dumps(heights)

    written = held.newest_result(held.find(first)) / "result.json"
    before = written.read_bytes(), written.stat().st_mtime_ns
    (measurements / f"{first}.json").unlink()
    assert main(["reconstruct", "--watch", "--library", str(held.root), "--once"]) == 1
    said = capsys.readouterr()
    assert str(written.parent) in said.out.splitlines()
    assert second not in said.out
    assert damaged in said.err
    assert second not in said.err
    assert json.loads((measurements / f"{first}.json").read_text()) == heights
    assert (written.read_bytes(), written.stat().st_mtime_ns) == before


def test_a_library_that_is_missing_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reconstruct", "--watch", "--library", str(tmp_path / "absent"), "--once"]) == 2
    assert "there is no library" in capsys.readouterr().err


def test_one_watch_works_on_a_library(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with only_watch(Library(tmp_path)):
        assert main(["reconstruct", "--watch", "--library", str(tmp_path), "--once"]) == 2
        assert "another watch works on this library: end that first" in capsys.readouterr().err
    assert main(["reconstruct", "--watch", "--library", str(tmp_path), "--once"]) == 0


def test_another_recipe_or_newer_results_are_measured_again(
    library: Library, watch_of: Callable[..., LibraryWatch], tmp_path: Path
) -> None:
    held = Library(tmp_path / "scans")
    shutil.copytree(library.root, held.root)
    for bundle in held.scans().bundles[1:]:
        shutil.rmtree(bundle.directory)
    (scan,) = held.scans().bundles
    place = held.root / MEASUREMENTS / f"{scan.scan_id}.json"
    watch = watch_of(held)
    (first,) = watch.look()
    assert first.folder is not None
    assert list(watch_of(held).look()) == []

    rough = watch_of(held, parameters=("Sq",))
    assert by_scan(list(rough.look())) == {scan.scan_id: None}
    assert json.loads(place.read_text())["recipe"]["parameters"] == ["Sq"]
    assert by_scan(list(watch_of(held).look())) == {scan.scan_id: None}

    # Newer results, whose name sorts before the older ones'.
    newer = first.folder.with_name(f"{version('retrograph')}-0")
    shutil.copytree(first.folder, newer)
    os.utime(newer, ns=(first.folder.stat().st_mtime_ns + 10**9,) * 2)
    assert [one.folder for one in watch.look()] == [newer]
    assert list(watch.look()) == []
    assert json.loads(place.read_text())["measured"]["result"] == newer.name

    record = newer / "result.json"
    record.write_bytes(record.read_bytes() + b"\n")
    assert [one.folder for one in watch_of(held).look()] == [newer]
    place.write_text("{")
    assert [one.folder for one in watch_of(held).look()] == [newer]
    assert list(watch_of(held).look()) == []


@pytest.mark.parametrize("every_s", ["inf", "nan", "0", "86401"])
def test_a_time_between_looks_that_makes_no_sense_is_refused(
    every_s: str, library: Library, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reconstruct", "--watch", "--library", str(library.root), "--once", "--every-s", every_s]) == 2
    assert "every-s" in capsys.readouterr().err
