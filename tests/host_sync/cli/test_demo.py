"""`retrosync demo`: from a simulated press to a picture, and what it refuses."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from host_sync.cli.main import main
from host_sync.viewer.catalogue import Catalogue


def test_the_story_ends_with_a_picture(
    small_board: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RETROGRAPH_CACHE", "")
    out = tmp_path / "story"
    demo = ["demo", "--out", str(out), "--board", str(small_board), "--no-browser"]
    assert main(demo) == 0
    told = capsys.readouterr().out
    assert "12 balls used, 0 rejected" in told
    heights = {part: int(um) for part, um in re.findall(r"^(\w+): highest point (\d+) ± \d+ µm", told, re.MULTILINE)}
    assert set(heights) == {"coin", "texture"}
    assert all(200 < um < 900 for um in heights.values())
    assert told.splitlines()[-1] == f"To see them again: retrosync view {out}"
    assert Catalogue(out).root == out / "library"
    assert (out / "demo.png").read_bytes().startswith(b"\x89PNG")
    assert len(list((out / "library" / "scans").iterdir())) == 2
    assert main(demo) == 2
    assert f"{out} exists already: show it with `retrosync view {out}`" in capsys.readouterr().err


def test_a_board_that_is_not_there_ends_it_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--out", str(tmp_path / "story"), "--board", "moon", "--no-browser"]) == 2
    told = capsys.readouterr().err
    assert told.startswith("retrosync: ")
    assert "twin-distant" in told
    assert told.count("\n") == 1
