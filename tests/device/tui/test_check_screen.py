"""The check standard by key presses: entered once, asked for each day, pressed, and its history drawn."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from device.bundles.check import CheckStandard
from device.store.checks import read_checks
from hal.interfaces import ButtonPress
from hal.simulator.scene import Press
from hal.simulator.surfaces import Sphere

Stage = Any

BALL = CheckStandard(name="cap 7", kind="ball", value_um=3000.0, tolerance_um=2.0)


async def pressed(stage: Stage, radius_mm: float) -> None:
    """Press a ball, push the button, lift, and wait."""
    for _ in range(24):
        stage.instrument.step()
    stage.bench.place(Press(Sphere(radius_mm), (0.0, 0.0), 0.0, 0.5))
    stage.bench.schedule_button(ButtonPress(stage.bench.clock.monotonic_ns() + 100_000_000, 0.05))
    for _ in range(12):
        stage.instrument.step()
    stage.bench.place(None)
    await stage.live(80)


async def checked(stage: Stage, radius_mm: float) -> None:
    """Start a check on its screen and press a ball."""
    await stage.press("4", "enter", "enter")
    await stage.live(2)
    assert stage.app.current_mode == "scan"
    assert "next: check of cap 7" in stage.text()
    await pressed(stage, radius_mm)


def test_a_standard_is_entered_pressed_and_charted(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("4", *["down"] * 7)
        assert "Enter the certified ball" in stage.text()
        await stage.press("enter", "enter")
        await stage.press(*["backspace"] * 4, *"cap 7", "enter", *"three", "enter", *"0.002", "enter")
        assert "write numbers, for example" in stage.text()
        assert "three" in stage.text()
        await stage.press("up", "shift+tab", *["backspace"] * 5)
        await stage.press("escape", "enter", "enter")
        await stage.press(*["backspace"] * 4, *"cap 7", "enter", *"3", "enter", *"0.002", "enter")
        await stage.live(2)
        assert "cap 7: ball, 3 ± 0.002 mm (due today)" in stage.text()
        assert "check due: Set-up" in stage.text()
        await checked(stage, 3.0)
        assert "Check of cap 7 passed" in stage.text()
        assert "check due" not in stage.text()
        await checked(stage, 2.7)
        assert "! Check of cap 7 FAILED" in stage.text()
        await stage.press("4")
        rows = [line for line in stage.lines() if "│" in line]
        assert sum(row.split("│")[1].count("o") for row in rows) == 1
        assert sum(row.split("│")[1].count("x") for row in rows) == 1
        assert "(FAILED: press it again, or calibrate)" in stage.text()
        await stage.press("3")
        assert "check of cap 7 FAILED" in stage.text()
        await stage.press("4", "enter", "down", "enter", "enter")
        await stage.press(*["backspace"] * 4, *"cap 8", "enter", *"3", "enter", *"0.002", "enter")
        await stage.live(2)
        assert "cap 8: ball, 3 ± 0.002 mm (due today)" in stage.text()
        assert "No check of it with this calibration yet." in stage.text()
        assert "! check of cap 7 FAILED" in stage.text()
        assert not [line for line in stage.lines() if "│" in line]

    play(scenario, root, size=(100, 30))


@pytest.mark.parametrize("size", [(80, 24), (40, 16)])
def test_a_look_alike_is_asked_about_and_pressed_again_or_failed(
    play: Callable[..., None], root: Path, size: tuple[int, int]
) -> None:
    async def scenario(stage: Stage) -> None:
        stage.instrument.set_standard(BALL)
        await stage.live(2)
        for answer, said in ((("enter",), "Press cap 7, then push."), (("down", "enter"), "Check of cap 7 FAILED")):
            if not stage.instrument.state.check.is_next:
                stage.instrument.begin_check()
            await pressed(stage, 2.5)
            rows = [line.split("│") for line in stage.lines() if line.count("│") == 2]
            shown = " ".join(" ".join(row[1] for row in rows).split())
            assert re.search(r"The ball reads radius 2\.\d\d ± 0\.1\d mm; the check standard is 3\.00 mm\.", shown)
            assert "Is the right ball on the gel?" in shown
            assert "Repeat with the right ball" in shown
            assert "It is the standard: FAILED" in shown
            assert not read_checks(root)
            await stage.press(*answer)
            await stage.live(4)
            assert said in stage.text()
        assert [check.passed for check in read_checks(root)] == [False]
        # The button answers too: a short push chooses, a long one selects.
        await stage.press("1")
        stage.instrument.begin_check()
        await pressed(stage, 2.5)
        await stage.push()
        await stage.push(3.0)
        await stage.live(4)
        assert [check.passed for check in read_checks(root)] == [False, False]
        assert "Is the right ball" not in stage.text()

    play(scenario, root, size=size)
