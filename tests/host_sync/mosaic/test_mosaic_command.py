"""`retrosync mosaic` from folder to folder."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mosaic_presses import grid_places, press_of_map, pressed, rough_target, write_press

from host_sync.cli.main import main
from host_sync.errors import MosaicError
from host_sync.mosaic.blending import disk_array
from host_sync.mosaic.presses import MOSAIC_FILE, presses_of
from host_sync.mosaic.writing import MosaicRecord
from host_sync.results.files import HEIGHT_SIGMA_FILE, RECORD_FILE, RELIEF_FILE
from host_sync.results.record import encode_record, read_record

SHAPE = (136, 182)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    random = np.random.default_rng(4)
    folder = tmp_path_factory.mktemp("results")
    target = rough_target((330, 430))
    for number, place in enumerate(grid_places(2, 2, (95.0, 127.0), random)):
        write_press(press_of_map(f"part-{number}", pressed(target, place, SHAPE, random)), folder)
    return folder


def test_results_become_one(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "whole"
    assert main(["mosaic", str(results), "--out", str(out)]) == 0
    words = capsys.readouterr().out
    assert "4 presses" in words
    assert "seams: at most" in words
    record = msgspec.json.decode((out / MOSAIC_FILE).read_bytes(), type=MosaicRecord)
    assert [place.name for place in record.presses] == ["part-0", "part-1", "part-2", "part-3"]
    assert len(record.used) >= 4
    assert (out / RELIEF_FILE).is_file()
    assert sorted(path.suffix for path in out.iterdir() if path.suffix == ".sum") == []
    assert main(["export", str(out), "--to", "gsf", "--out", str(tmp_path / "exported")]) == 0
    assert main(["measure", str(out), "--parameters", "Sa"]) == 0


def test_a_layout_needs_every_scan(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layout = tmp_path / "places.csv"
    layout.write_text("scan,right_mm,down_mm\npart-0,0,0\npart-1,6.1,0\npart-2,0,4.6\n", encoding="utf-8")
    given = ["mosaic", str(results), "--out", str(tmp_path / "whole"), "--layout", str(layout)]
    assert main(given) == 2
    assert "holds no line for part-3" in capsys.readouterr().err
    layout.write_text("scan,right_mm\npart-0,0\n", encoding="utf-8")
    assert main(given) == 2
    assert "line 2: needs scan, right_mm, down_mm" in capsys.readouterr().err
    layout.write_text(
        "scan,right_mm,down_mm\npart-0,0,0\npart-1,6.1,0\npart-2,0,4.6\npart-3,6.1,4.6\n", encoding="utf-8"
    )
    assert main([*given, "--json"]) == 0
    assert msgspec.json.decode(capsys.readouterr().out, type=MosaicRecord).left_out == ()


def test_one_result_is_no_mosaic(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["mosaic", str(results / "part-0"), "--out", str(tmp_path / "whole")]) == 2
    assert "a mosaic needs two presses or more" in capsys.readouterr().err
    assert not (tmp_path / "whole").exists()


def test_no_press_is_replaced_and_no_mosaic_is_a_press(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in results.rglob("*") if path.is_file()}
    for out, words in (("part-0", "would replace"), ("part-0/whole", "would replace")):
        assert main(["mosaic", str(results), "--out", str(results / out)]) == 2
        assert words in capsys.readouterr().err
    assert main(["mosaic", str(results / "part-0"), str(results / "part-1"), "--out", str(results / "part-2")]) == 2
    assert "holds a result that is no mosaic" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in results.rglob("*") if path.is_file()} == before
    copied = tmp_path / "results"
    shutil.copytree(results, copied)
    records = []
    for _ in range(2):
        assert main(["mosaic", str(copied), "--out", str(copied / "whole")]) == 0
        assert "left out" not in capsys.readouterr().out
        records.append(msgspec.json.decode((copied / "whole" / MOSAIC_FILE).read_bytes(), type=MosaicRecord))
    assert len(records[0].used) == len(records[1].used)
    assert records[0].rejected == ()
    assert main(["mosaic", str(copied / "whole"), str(copied / "part-0"), "--out", str(tmp_path / "more")]) == 2
    assert "is a mosaic: name the results of its presses" in capsys.readouterr().err


def test_doubts_of_presses_are_doubts_of_the_mosaic(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copied = tmp_path / "results"
    shutil.copytree(results, copied)
    part = copied / "part-1"
    doubted = msgspec.structs.replace(
        read_record(part), calibration_passed=False, calibration_failed_checks=("too few balls",),
        uncovered_sectors=("left edge",), warnings=("lights drifted",),
    )  # fmt: skip
    (part / RECORD_FILE).write_bytes(encode_record(doubted))
    assert main(["mosaic", str(copied), "--out", str(tmp_path / "whole")]) == 0
    shown = capsys.readouterr().out
    for words in (
        "checks: too few balls",
        "balls of the calibration do not cover left edge (part-1)",
        "lights drifted",
    ):
        assert words in shown
    assert read_record(tmp_path / "whole").calibration_failed_checks == ("too few balls",)


def test_no_uncertainty_is_made_up(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copied = tmp_path / "results"
    shutil.copytree(results, copied)
    (copied / "part-1" / HEIGHT_SIGMA_FILE).unlink()
    out = tmp_path / "whole"
    assert main(["mosaic", str(copied), "--out", str(out)]) == 0
    assert "σ" not in capsys.readouterr().out.split("seams")[0]
    assert not (out / HEIGHT_SIGMA_FILE).exists()
    found = read_record(out)
    assert found.height_sigma_median_um is None
    assert "uncertainty is unknown, as it is of part-1" in found.warnings
    record = msgspec.json.decode((out / MOSAIC_FILE).read_bytes(), type=MosaicRecord)
    assert all(link.seam_sigmas is None for link in record.used if "part-1" in (link.first, link.second))


def test_presses_of_two_sizes_are_refused(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    random = np.random.default_rng(8)
    place = grid_places(1, 1, (10.0, 10.0), random)[0]
    write_press(press_of_map("larger", pressed(rough_target((330, 430)), place, (150, 200), random)), tmp_path)
    given = ["mosaic", str(results / "part-0"), str(tmp_path / "larger"), "--out", str(tmp_path / "whole")]
    assert main(given) == 2
    assert "presses of one mosaic need one size" in capsys.readouterr().err


def test_what_is_left_out_is_a_doubt_and_no_success(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    random = np.random.default_rng(9)
    place = grid_places(1, 1, (10.0, 10.0), random)[0]
    write_press(press_of_map("stranger", pressed(rough_target((330, 430), seed=8), place, SHAPE, random)), tmp_path)
    given = [str(results / "part-0"), str(results / "part-1"), str(tmp_path / "stranger")]
    assert main(["mosaic", *given, "--out", str(tmp_path / "whole")]) == 1
    said = capsys.readouterr().out
    assert "2 presses, 1 overlap\n" in said
    assert "DOUBTFUL: left out, as no overlap was found: stranger" in said
    assert "DOUBTFUL: the place of part-0, part-1 rests on overlaps that no other overlap confirms" in said


def test_a_mosaic_does_not_become_the_results_of_a_scan(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = []
    for number, folder in enumerate(sorted(results.iterdir())):
        folders.append(tmp_path / "scans" / f"scan-{number}" / "results" / "now")
        shutil.copytree(folder, folders[-1])
    out = tmp_path / "scans" / "scan-0" / "results" / "whole"
    with pytest.raises(MosaicError, match="lies in the library's scans"):
        presses_of(folders, out, tmp_path)
    assert len(presses_of(folders, tmp_path / "whole", tmp_path)) == 4


def test_room_for_sums_is_taken_from_the_disk_at_once(tmp_path: Path) -> None:
    sums = disk_array(tmp_path / "height.sum", np.float32, (300, 400))
    assert (tmp_path / "height.sum").stat().st_blocks * 512 >= sums.nbytes == 480_000
    assert not sums.any()
    sums[299, 399] = 1.0
    assert sums.sum() == 1.0


@pytest.mark.skipif(not Path("/proc/self/limits").exists(), reason="this system limits files otherwise")
def test_a_disk_without_room_ends_in_a_sentence_and_leaves_nothing(results: Path, tmp_path: Path) -> None:
    program = (
        "import resource, sys; from host_sync.cli.main import main; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)); sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", program, "mosaic", str(results), "--out", str(tmp_path / "whole")]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert f"{tmp_path / 'whole'} cannot be written" in run.stderr
    assert all(line.startswith("retrosync: ") for line in run.stderr.splitlines())  # steps, then the error
    assert list(tmp_path.iterdir()) == []
