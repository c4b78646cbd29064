"""An area on the Scan screen, scan by scan: map, way, overlap; a refused press or an unknown place changes nothing."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hal.simulator.scene import Press
from tests.device.tui.test_way_back import AT_START, Bumps, scanned

Stage = Any


def at(right_mm: float, down_mm: float) -> Press:
    """The object as the instrument sees it from there: it moves the other way."""
    return replace(AT_START, centre_mm=(-right_mm, -down_mm))


async def begun(stage: Stage, width: str = "26", height: str = "14") -> None:
    await stage.press("w")
    await stage.press(*width, "enter", *height, "enter")
    await stage.live()


@pytest.mark.parametrize("size", [(40, 16), (80, 24)])
def test_an_area_is_covered_press_by_press(play: Callable[..., None], root: Path, size: tuple[int, int]) -> None:
    async def scenario(stage: Stage) -> None:
        await begun(stage)
        assert "Press the area's upper left corner, then push the button." in stage.text()
        assert "area of 26 x 14 mm" in stage.text()
        assert "Esc leave" in stage.text()
        await scanned(stage, at(-4.0, 0.0))
        first = stage.instrument.state.area
        share = float(first.map.covered.mean())
        assert 0.4 < share < 0.9
        assert "mm right" in first.sentence
        assert first.sentence in stage.text()
        rows = [row for row in stage.lines() if "##" in row]
        assert rows
        assert all(row.endswith("·") for row in rows)
        await scanned(stage, at(2.0, 0.0))
        second = stage.instrument.state.area
        assert float(second.map.covered.mean()) > share + 0.1
        assert "overlap" in second.sentence
        assert second.sentence in stage.text()
        assert stage.instrument.state.scans_stored == 2

    play(scenario, root, size=size)


@pytest.mark.parametrize("size", [(40, 16), (80, 24)])
def test_an_unknown_place_and_a_refused_press_keep_what_is_covered(
    play: Callable[..., None], root: Path, size: tuple[int, int]
) -> None:
    async def scenario(stage: Stage) -> None:
        await begun(stage)
        await scanned(stage, at(-4.0, 0.0))
        covered = stage.instrument.state.area.map.covered.copy()
        await scanned(stage, replace(AT_START, surface=Bumps(2)))
        assert "Place unknown" in stage.instrument.state.area.sentence
        assert (stage.instrument.state.area.map.covered == covered).all()
        assert stage.instrument.state.area.sentence in stage.text()
        gel = stage.instrument.state.gel
        stage.instrument.change_gel("another")
        await scanned(stage, at(2.0, 0.0))
        assert "Not scanned" in stage.text()
        assert (stage.instrument.state.area.map.covered == covered).all()
        stage.instrument.change_gel(gel.gel_id, gel.slab_thickness_mm)
        await stage.live(2)
        await scanned(stage, at(2.0, 0.0))
        assert stage.instrument.state.area.map.covered.sum() > covered.sum()

    play(scenario, root, size=size)


def test_an_area_of_one_field_ends_in_one_press(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await begun(stage, "1", "1")
        await scanned(stage, AT_START)
        assert stage.instrument.state.area.is_done
        assert "Covered: 100%" in stage.text()

    play(scenario, root)


@pytest.mark.parametrize("key", ["escape", "w"])
def test_leaving_keeps_the_scans_and_the_size(play: Callable[..., None], root: Path, key: str) -> None:
    async def scenario(stage: Stage) -> None:
        await begun(stage)
        await scanned(stage, AT_START)
        await stage.press(key)
        await stage.live()
        assert stage.instrument.state.area is None
        assert "its scans are kept" in stage.text()
        assert "Esc leave" not in stage.text()
        assert "GOOD #1" in stage.text()
        assert stage.instrument.state.scans_stored == 1
        await stage.press("p")
        assert " z " in stage.text()  # the relief has its keys again
        await stage.press("p", "w")
        assert "26" in stage.text()
        await stage.press("escape")
        await stage.live()
        assert stage.instrument.state.area is None

    play(scenario, root)


@pytest.mark.parametrize(("width", "height"), [("0", "10"), ("20", "301"), ("wide", "10"), ("nan", "10")])
def test_a_size_that_is_none_is_asked_again(play: Callable[..., None], root: Path, width: str, height: str) -> None:
    async def scenario(stage: Stage) -> None:
        await begun(stage, width, height)
        assert "A number of mm above 0" in stage.text()
        assert stage.instrument.state.area is None
        # The field that is wrong is the one that keys go to.
        assert stage.app.focused is not None
        assert stage.app.focused.name == ("Height, mm" if height == "301" else "Width, mm")

    play(scenario, root)


def test_the_search_for_a_spot_ends_the_area(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await begun(stage)
        await scanned(stage, AT_START)
        await stage.press("3", "w")
        await stage.live()
        assert stage.instrument.state.area is None
        assert stage.instrument.state.spot.counter == 1

    play(scenario, root)
