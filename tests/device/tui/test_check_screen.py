"""The check standard by key presses: entered once, asked for each day, pressed, and its history drawn."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hal.interfaces import ButtonPress
from hal.simulator.scene import Press
from hal.simulator.surfaces import Sphere

Stage = Any


async def checked(stage: Stage, radius_mm: float) -> None:
    """Start a check on its screen and press a ball."""
    await stage.press("4", "enter", "enter")
    await stage.live(2)
    assert stage.app.current_mode == "scan"
    assert "next: check of cap 7" in stage.text()
    for _ in range(24):
        stage.instrument.step()
    stage.bench.place(Press(Sphere(radius_mm), (0.0, 0.0), 0.0, 0.5))
    stage.bench.schedule_button(ButtonPress(stage.bench.clock.monotonic_ns() + 100_000_000, 0.05))
    for _ in range(12):
        stage.instrument.step()
    stage.bench.place(None)
    await stage.live(80)


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
        await checked(stage, 2.4)
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
