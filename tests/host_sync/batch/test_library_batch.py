"""A library by two processes: the same bits as by one, whatever dies on the way."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest
from batch_results import Said, contents, plain
from mortal_work import DieOnce

from device.bundles.scan import ScanBundle
from device.errors import OutputError
from host_sync.batch.library_batch import ReconstructionOptions, ScanOutcome, one_by_one, reconstruct_scans
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_file.inputs import CalibrationCache
from host_sync.calibration_file.kept_calibration import KeptCalibration
from host_sync.cli.main import main
from host_sync.library.library import Library
from host_sync.reconstruction.scans import LibraryReconstructor


@pytest.fixture(scope="module")
def alone(
    library: Library, calibrator: Calibrator, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Library, list[ScanOutcome]]:
    """The library's copy with the results of one process, and what it said."""
    copy = copied(library, tmp_path_factory.mktemp("alone") / "scans")
    return copy, list(one_by_one(copy.scans().bundles, LibraryReconstructor(copy, calibrator=calibrator)))


def copied(library: Library, root: Path) -> Library:
    shutil.copytree(library.root, root)
    return Library(root)


@pytest.mark.parametrize("at", ["slopes and height", "results"])
def test_two_processes_give_the_bits_of_one_though_one_is_killed_in_mid_scan(
    library: Library,
    alone: tuple[Library, list[ScanOutcome]],
    calibration_cache: CalibrationCache,
    tmp_path: Path,
    at: str,
) -> None:
    batch = copied(library, tmp_path / "batch")
    scans = batch.scans().bundles
    made: list[str] = []

    def obtained(kept: KeptCalibration, source: str) -> None:
        made.append(kept.facts.calibration_id)

    job = LibraryReconstructor(batch, calibrator=Calibrator(calibration_cache, obtained=obtained))
    marker = tmp_path / "died"
    found = list(
        reconstruct_scans(scans, ReconstructionOptions(batch.root, report_progress=DieOnce(marker, at)), job, 2)
    )
    assert marker.exists()
    assert Counter(one.scan for one in found) == Counter(scan.scan_id for scan in scans)
    assert plain(found, batch) == plain(alone[1], alone[0])
    assert [one.reason is None for one in sorted(found, key=lambda one: one.scan)] == [True, True, False]
    assert contents(batch) == contents(alone[0])
    assert len(made) == 1


def test_the_command_line_gives_a_library_to_processes(
    library: Library,
    alone: tuple[Library, list[ScanOutcome]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    batch = copied(library, tmp_path / "batch")
    assert main(["reconstruct", "--library", str(batch.root), "--workers", "2", "--json"]) == 1
    said = msgspec.json.decode(capsys.readouterr().out, type=Said, dec_hook=lambda kind, text: kind(text))
    assert plain(list(said.scans), batch) == plain(alone[1], alone[0])
    assert contents(batch) == contents(alone[0])


def test_a_scan_without_its_calibration_is_named_and_the_rest_is_done(library: Library, tmp_path: Path) -> None:
    batch = copied(library, tmp_path / "batch")
    shutil.rmtree(batch.root / "calibrations")
    scans = batch.scans().bundles
    outcomes = list(reconstruct_scans(scans, ReconstructionOptions(batch.root), LibraryReconstructor(batch), 2))
    assert [one.scan for one in outcomes] == [scan.scan_id for scan in scans]
    assert all("pull it from the device" in (one.reason or "") for one in outcomes)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--library", "LIB", "--workers", "0"], "workers"),
        (["set.toml", "--out", "out", "--workers", "2"], "--workers is for the scans of a library"),
    ],
)
def test_workers_that_make_no_sense_are_refused(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reconstruct", *arguments]) == 2
    assert words in capsys.readouterr().err


class Unwritable:
    """A job whose calibrations meet a full temporary folder."""

    facts = SimpleNamespace(calibration_id="full")

    def calibration_of(self, _: ScanBundle) -> Unwritable:
        return self

    def write(self, path: Path) -> None:
        raise OutputError(f"{path.name} cannot be written (No space left on device): choose another place")


def test_a_full_temporary_folder_is_said_of_every_scan(library: Library, tmp_path: Path) -> None:
    scans, work = library.scans().bundles, ReconstructionOptions(library.root)
    job = cast("LibraryReconstructor", Unwritable())
    found = list(reconstruct_scans(scans, work, job, 2))
    assert [one.scan for one in found] == [scan.scan_id for scan in scans]
    assert all("No space left" in (one.reason or "") for one in found)

    found = list(reconstruct_scans(scans, ReconstructionOptions(tmp_path / "absent"), job, 2))
    assert [one.scan for one in found] == [scan.scan_id for scan in scans]
    assert all("no temporary folder" in (one.reason or "") for one in found)


def test_a_scan_that_is_named_twice_is_reconstructed_once(
    library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    batch = copied(library, tmp_path / "batch")
    name = batch.scans().bundles[0].scan_id
    assert main(["reconstruct", "--library", str(batch.root), name, name, name, "--workers", "2", "--json"]) == 0
    assert [one["scan"] for one in json.loads(capsys.readouterr().out)["scans"]] == [name]
