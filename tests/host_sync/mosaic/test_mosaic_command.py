"""`retrosync mosaic` from folder to folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mosaic_presses import grid_places, press_of_map, pressed, rough_target, write_press

from host_sync.cli.main import main
from host_sync.mosaic.record import MOSAIC_FILE, MosaicRecord
from host_sync.results.files import HEIGHT_SIGMA_FILE, RELIEF_FILE
from host_sync.results.record import read_record

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
