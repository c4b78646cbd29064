"""Back to an earlier scan's spot on the screens: touches say the way and store nothing, until the operator leaves."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hal.simulator.scene import Press
from tests.device.cli.test_guide import Bumps

Stage = Any

AT_START = Press(Bumps(1), (0.0, 0.0), 0.0, 0.5)
MOVED = replace(AT_START, centre_mm=(3.0, -2.0), turn_rad=float(np.radians(4.0)))


async def scanned(stage: Stage, press: Press) -> None:
    """A push on this press; then untouched skin, until the scan is stored."""
    stage.bench.place(press)
    await stage.live(3)
    await stage.push()
    stage.bench.place(None)
    stage.bench.clock.sleep(1.0)
    await stage.live(30)


async def searched(stage: Stage) -> None:
    """One scan of bumps; then the search for its spot, from Scans."""
    await scanned(stage, AT_START)
    assert stage.instrument.state.scans_stored == 1
    await stage.press("3", "w")
    await stage.live(2)


def test_touches_say_the_way_until_they_are_on_the_spot(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await searched(stage)
        assert stage.app.current_mode == "scan"
        assert "TO #1 Touch the object lightly" in stage.text()
        assert "finding #1, nothing is stored" in stage.text()
        assert "Esc leave" in stage.text()
        stage.bench.place(MOVED)
        await stage.live(3)
        await stage.push()
        assert "mm right and" in stage.instrument.state.spot.sentence
        assert "mm right and" in stage.text()
        assert "mm up, then turn" in stage.text()
        stage.bench.place(AT_START)
        await stage.live(3)
        await stage.press("space")
        await stage.live(2)
        assert "On the spot" in stage.text()
        assert stage.instrument.state.spot.is_reached
        assert stage.instrument.state.scans_stored == 1

    play(scenario, root)


@pytest.mark.parametrize("size", [(40, 16), (80, 24)])
def test_an_unknown_place_is_said_in_full(play: Callable[..., None], root: Path, size: tuple[int, int]) -> None:
    async def scenario(stage: Stage) -> None:
        await searched(stage)
        stage.bench.place(replace(AT_START, surface=Bumps(2)))
        await stage.live(3)
        await stage.push()
        assert "not recognised" in stage.instrument.state.spot.sentence
        assert "Place unknown: not recognised: touch nearer to the earlier place." in stage.text()
        assert "Esc leave" in stage.text()

    play(scenario, root, size=size)


def test_escape_leaves_and_so_does_the_key_on_the_same_scan(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await searched(stage)
        await stage.press("escape")
        await stage.live()
        assert "pushes scan." in stage.text()
        assert "Esc leave" not in stage.text()
        await scanned(stage, AT_START)
        assert stage.instrument.state.scans_stored == 2
        await stage.press("3", "home", "w")
        await stage.live()
        assert stage.instrument.state.spot.counter == 2
        await stage.press("3", "w")
        await stage.live()
        assert stage.instrument.state.spot is None

    play(scenario, root)


def test_a_scan_without_a_quick_look_is_refused(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("space")
        await stage.live(3)
        (scan,) = (root / "scans").iterdir()
        (scan / "quick-look-um.tif").write_bytes(b"no picture")
        await stage.press("3", "w")
        assert stage.app.current_mode == "scans"
        assert "cannot be read" in stage.text()
        assert stage.instrument.state.spot is None

    play(scenario, root)


def test_a_full_store_still_leads_back(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await searched(stage)
        await stage.press("f", *["down"] * 7, "enter")
        stage.bench.place(MOVED)
        await stage.live(3)
        await stage.push()
        assert "mm right and" in stage.instrument.state.spot.sentence
        await stage.press("escape")
        await stage.live()
        await stage.push()
        assert "has no room for another scan" in stage.instrument.state.sentence
        assert stage.instrument.state.scans_stored == 1

    play(scenario, root, is_demo=True)
