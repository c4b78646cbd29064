"""The calibration screen by key presses: start, step by step to the numbers, stop, and what goes wrong."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Stage = Any


async def _calibrate(stage: Stage, most_steps: int = 400) -> None:
    """Take every requested frame; the twin's operator presses at the requested places."""
    for _ in range(most_steps):
        guide = stage.instrument.state.guide
        if guide and guide.is_over:
            return
        if stage.instrument.state.activity == "calibrating":
            stage.instrument.press()
        await stage.live(2)
    raise AssertionError("the calibration has no end")


def test_a_stopped_calibration_is_not_started_again_by_the_push_that_it_had_asked_for(
    play: Callable[..., None], root: Path
) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("2", "space")
        await stage.live(2)
        assert stage.instrument.state.activity == "calibrating"
        await stage.press("1")
        assert "A calibration is under way: key 2 shows it." in stage.text()
        await stage.press("2", "x")
        await stage.live(60)
        assert stage.instrument.state.activity == "ready"
        assert "Calibration stopped" in stage.text()

    play(scenario, root)


def test_the_first_presses_by_one_key(play: Callable[..., None], empty_root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("2")
        assert "Ball of 3 mm radius" in stage.text()
        assert "0 of 12" in stage.text()
        await stage.press("space")
        await stage.live()
        assert "Touch nothing with the gel" in stage.text()
        await stage.press("space")
        await stage.live(2)
        assert "press the ball far left, at the top" in stage.text()
        assert "press here" in stage.text()
        await stage.press("space")
        await stage.live(2)
        assert "1 of 12" in stage.text()
        assert "Ball found, contact diameter 3." in stage.text()
        assert "o" in "".join(stage.lines()[3:15])

    play(scenario, empty_root)


@pytest.mark.slow
def test_a_passed_calibration_shows_its_numbers_and_scans(play: Callable[..., None], empty_root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("2", "space")
        await _calibrate(stage)
        shown = stage.text()
        assert "Calibration passed and is active." in shown
        assert "pass balls used" in shown
        assert "FAIL" not in shown
        assert "calibrated just now" in shown
        assert "■ ■ ■ ■ ■ ■" in shown
        await stage.press("1", "space")
        await stage.live(3)
        assert stage.instrument.state.scans_stored == 1

    play(scenario, empty_root)


def test_the_ball_is_chosen_by_a_key(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("2")
        for radius in ("4", "5", "1", "1.5", "2", "2.5", "3"):
            await stage.press("r")
            assert f"Ball of {radius} mm radius" in stage.text()

    play(scenario, root)


def test_after_stopping_the_previous_calibration_stays_active(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        before = stage.instrument.state.calibration.calibration_id
        await stage.press("2", "space")
        await stage.live()
        assert "stop" in stage.text()
        await stage.press("x")
        await stage.live()
        assert "! Calibration stopped; the previous one stays active." in stage.text()
        assert stage.instrument.state.calibration.calibration_id == before

    play(scenario, root)


@pytest.mark.slow
def test_no_ball_anywhere_fails_and_says_what_to_do(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        before = stage.instrument.state.calibration.calibration_id
        await stage.press("2", "r", "r", "r", "space")
        for _ in range(90):
            await stage.live()
            stage.bench.place(None)  # nothing is ever pressed
            stage.instrument.press()
            if stage.instrument.state.guide.is_over:
                break
        await stage.live()
        assert "! only 0 of 12 presses showed a usable ball" in stage.text()
        assert stage.instrument.state.guide.phase == "failed"
        assert stage.instrument.state.calibration.calibration_id == before

    play(scenario, root)


def test_leaving_while_calibrating_asks_first(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("2", "space")
        await stage.live()
        await stage.press("q")
        assert "Stop the calibration?" in stage.text()
        await stage.press("n")
        assert stage.app.is_running
        assert "Stop the" not in stage.text()

    play(scenario, root)


def test_the_button_alone_starts_and_takes_every_step(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("2")
        await stage.push()
        await stage.live()
        assert stage.instrument.state.activity == "calibrating"
        await stage.push()
        assert "press the ball" in stage.text()

    play(scenario, root)
