"""A store without room, by key presses: all but a new scan works, and deleting makes room."""

from collections.abc import Callable
from pathlib import Path

import pytest

from device.instrument.health import NO_ROOM
from device.store.choices import Settings
from tests.device.tui.conftest import Stage
from tests.device.tui.test_way_back import AT_START, MOVED, scanned

HOUSEKEEPING_S = 6.0
"""After this time the instrument has looked at the free space again."""


async def waited(stage: Stage) -> None:
    stage.bench.clock.sleep(HOUSEKEEPING_S)
    await stage.live(2)


async def filled(stage: Stage, scans: int = 3) -> None:
    """So many scans; then a disk without room, of which the screens know."""
    for _ in range(scans):
        stage.instrument.press()
        await stage.live(2)
    await stage.press("f", *["down"] * 7, "enter")
    await waited(stage)


def counters(stage: Stage) -> list[int]:
    return [entry.counter for entry in stage.instrument.history().scans]


@pytest.mark.parametrize("size", [(80, 24), (40, 16)])
def test_a_full_store_refuses_scans_and_nothing_else(
    play: Callable[..., None], root: Path, size: tuple[int, int]
) -> None:
    async def scenario(stage: Stage) -> None:
        await filled(stage)
        await stage.press("space")
        await stage.live(2)
        assert counters(stage) == [3, 2, 1]
        assert "no room for another scan" in stage.text()
        assert "Ready" not in stage.text()
        await stage.press("3", "b", "n", *"hair", "enter")
        entry = stage.instrument.history().scans[0]
        assert entry.mark is not None
        assert (entry.mark.opinion, entry.mark.note) == ("bad", "hair")
        await stage.press("p")
        assert "▲" in stage.text() or size[0] < 80
        await stage.press("p", "x", "z")
        assert counters(stage) == [3, 2, 1]
        await stage.press("1", "z")
        await stage.live(2)
        assert "Zero check" in stage.text()
        await stage.press("2")
        assert "Ball of 3 mm" in stage.text()
        await stage.press("4")
        assert "Back to Scan" in stage.text()

    play(scenario, root, size=size, is_demo=True)


def test_deleting_makes_room_and_ready_comes_back_by_itself(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        pressed = stage.bench.pressed
        await filled(stage, scans=4)
        assert "Ready" not in stage.text()
        assert "No room" in stage.text()
        while stage.instrument.state.scans_left == 0 and counters(stage):
            await stage.press("3", "x")
            await waited(stage)
        kept = counters(stage)
        assert kept, "deleting all scans was needed for one"
        assert NO_ROOM not in stage.instrument.state.alarms
        stage.bench.place(pressed)
        await stage.press("1")
        await stage.live(20)
        assert "Ready" in stage.text()
        await stage.press("space")
        stage.bench.place(None)
        await waited(stage)
        await stage.live(30)
        assert len(counters(stage)) == len(kept) + 1

    play(scenario, root, is_demo=True)


def test_a_refused_press_leaves_deleted_scans_that_do_not_make_room(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await filled(stage, scans=2)
        stage.instrument.set_settings(Settings(capture="lights"))  # takes the room of several
        await stage.press("3", "x", "1", "space")
        await stage.live(2)
        assert "no room for another scan" in stage.text()
        await stage.press("3", "z")
        assert counters(stage) == [2, 1]

    play(scenario, root, is_demo=True)


def test_touches_on_the_way_back_need_no_room_and_take_none(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await scanned(stage, AT_START)
        stage.instrument.press()
        await stage.live(2)
        await filled(stage, scans=0)
        await stage.press("3", "x", "w")
        await stage.live(2)
        stage.bench.place(None)
        await stage.push()
        await stage.live(3)
        assert "Touch the object lightly." in stage.text()
        assert "Press the object" not in stage.text()
        stage.bench.place(MOVED)
        await stage.live(3)
        await stage.push()
        assert "mm right and" in stage.instrument.state.spot.sentence
        assert "Not scanned" not in stage.text()
        await stage.press("escape", "3", "z")
        assert counters(stage) == [2, 1]

    play(scenario, root, is_demo=True)
