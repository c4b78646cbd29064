"""At rest the screens draw nothing and the instrument takes few frames."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from device.instrument.live import PERIOD_S, SLEEP_AFTER_S, UNSEEN_PERIOD_S
from device.tui.widgets.navigation import KeyHint, Words

Stage = Any


def frames_in_a_second(stage: Stage) -> int:
    """Live frames that the instrument takes in a second of its clock."""
    began_ns, seen = stage.bench.clock.monotonic_ns(), set()
    while stage.bench.clock.monotonic_ns() - began_ns < 1_000_000_000:
        stage.instrument.step()
        if stage.instrument.state.live:
            seen.add(stage.instrument.state.live.at_ns)
    return len(seen)


def test_few_live_frames_are_taken_where_none_is_shown(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.live(5)
        assert frames_in_a_second(stage) > 0.6 / PERIOD_S
        await stage.press("4")
        assert frames_in_a_second(stage) <= 1.0 / UNSEEN_PERIOD_S + 1
        stage.instrument.set_auto_shutter(True)
        assert frames_in_a_second(stage) > 0.6 / PERIOD_S
        stage.instrument.set_auto_shutter(False)
        await stage.press("1")
        assert frames_in_a_second(stage) > 0.6 / PERIOD_S
        stage.bench.clock.sleep(SLEEP_AFTER_S + 1.0)
        assert frames_in_a_second(stage) == 0

    play(scenario, root)


def test_the_same_words_are_not_drawn_again(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("4")
        (panel,) = [words for words in stage.app.screen.query(Words) if words.id == "panel"]
        before = panel.visual
        await stage.show()
        assert panel.visual is before
        panel.update("something else")
        assert panel.visual is not before

    play(scenario, root)


def test_the_same_keys_are_not_drawn_again_and_others_are(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        for screen in "1234":
            await stage.press(screen)
            before = list(stage.app.screen.query(KeyHint))
            for _ in range(3):
                await stage.live(1)
            assert list(stage.app.screen.query(KeyHint)) == before
        await stage.press("2", "space")
        await stage.live(2)
        assert "stop" in stage.text().splitlines()[-1]
        assert "ball radius" not in stage.text().splitlines()[-1]

    play(scenario, root)
