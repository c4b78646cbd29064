"""Search by likeness: figures that do not turn with the object, and an index that is repaired."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from mosaic_presses import press_of_map, write_press
from press_pairs import Hand, press

from device.surface import HeightMap
from hal.simulator.operator import specimen
from host_sync.cli.main import main
from host_sync.errors import Indescribable
from host_sync.likeness.descriptor import describe
from host_sync.likeness.search import INDEX_FILE, alike, nearest, updated


def gallery_press(name: str, turn: float, seed: int) -> HeightMap:
    item = specimen(name)
    return press(item.surface, Hand(0.3, -0.2, turn, item.indentation_mm), np.random.default_rng(seed))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    library = tmp_path_factory.mktemp("library")
    for name in ("coin", "groove"):
        for number in range(2):
            folder = library / "scans" / f"{name}-{number}" / "results"
            folder.mkdir(parents=True)
            write_press(press_of_map("one", gallery_press(name, 0.9 * number, number).z_um), folder)
    folder = library / "scans" / "empty-0" / "results"
    folder.mkdir(parents=True)
    write_press(press_of_map("one", np.zeros((272, 364), np.float32)), folder)
    return library


@pytest.fixture
def library(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "library"))


def test_a_turned_press_is_nearer_than_another_object() -> None:
    rows = [describe(gallery_press(name, turn, 3)) for name, turn in (("coin", 0.0), ("coin", 1.2), ("texture", 0.0))]
    assert [at for at, _ in nearest(rows[0], np.array(rows[1:]), 2)] == [0, 1]


def test_untouched_skin_has_no_descriptor() -> None:
    with pytest.raises(Indescribable, match="no skin contact"):
        describe(HeightMap(np.zeros((200, 200), np.float32), 48.0))


def test_the_command_lists_the_other_press_and_what_was_not_compared(
    library: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = str(library / "scans" / "groove-0" / "results" / "one")
    assert main(["list", "--like", asked, "--library", str(library), "--json", "-n", "2"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [answer["found"][0]["scan"], answer["compared"], len(answer["found"])] == ["groove-1", 3, 2]
    assert answer["left_out"][0][0] == "empty-0"
    assert "no skin contact" in answer["left_out"][0][1]


def test_the_index_follows_the_library_and_is_repaired(library: Path) -> None:
    said: list[str] = []
    before = updated(library, said.append)
    assert len(said) == 5
    said.clear()
    updated(library, said.append)
    assert said == []
    shutil.rmtree(library / "scans" / "coin-1")
    assert len(updated(library, said.append)) == 4
    assert said == []
    index = library / INDEX_FILE
    whole = index.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"not an index" * 100, b""):
        index.write_bytes(damaged)
        again = updated(library, said.append)
        assert len(said) == 4
        said.clear()
        for folder, entry in again.items():
            assert np.array_equal(entry.row, before[folder].row) if entry.row is not None else entry.reason
    asked = library / "scans" / "coin-0" / "results" / "one"
    assert "coin-0" not in [one.scan for one in alike(asked, library).found]
