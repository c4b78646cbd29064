"""Measuring on the quick look by key presses: two points, level, zoom."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

Stage = Any


def test_two_points_are_measured_and_a_zero_check_gives_the_uncertainty(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        await stage.press("3", "p", "c", *["right"] * 6)
        assert re.search(r"dz -?[0-9.]+ µm · distance [0-9.]+ ± 0.[0-9]+ mm · angle -?[0-9.]+°", stage.text())
        assert "± of heights: zero check first" in stage.text()
        assert re.search(r"[RP]a [0-9.]+ [RP]z [0-9.]+ µm", stage.text())
        stage.bench.place(None)
        stage.instrument.zero_check()
        await stage.live(3)
        await stage.press("down", "right")
        assert re.search(r"dz -?[0-9.]+ ± [0-9.]+ µm", stage.text())
        assert re.search(r"Sa [0-9.]+ ± [0-9.]+ Sz [0-9.]+ ± [0-9.]+ µm", stage.text())
        before = stage.text()
        await stage.press("l", "right", "left")
        assert stage.text() != before

    play(scenario, root, size=(100, 30))


def test_zoom_follows_the_cursor_and_keeps_its_place(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        await stage.press("3", "p", "right", "right")
        place = re.search(r"x [0-9.]+ mm y [0-9.]+ mm z -?[0-9.]+ µm", stage.text())
        assert place
        relief = stage.lines()[2:12]
        await stage.press("plus", "plus")
        assert place[0] in stage.text()
        assert stage.lines()[2:12] != relief
        await stage.press("right")
        moved = re.search(r"x ([0-9.]+) mm", stage.text())
        before = re.search(r"x ([0-9.]+) mm", place[0])
        assert moved
        assert before
        assert 0.0 < float(moved[1]) - float(before[1]) < 0.2
        await stage.press(*["minus"] * 3)
        assert "▲" in stage.text()

    play(scenario, root, size=(100, 30))
