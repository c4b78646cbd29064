"""The tutorials: every command and program in them runs as it is written, one after the other."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
import uvicorn
from near_lamps import RADIUS_PX, SHAPE, NearLamps, press_px
from pressed_frames import APEX_PX, PLACES
from typed_commands import PROGRAMS, split

from device.balls.sphere import Ball
from device.cli import instrument_commands, screens
from device.surface import Float64Array
from device.tui.screens.app import RetroscanApp
from hal import board_profile
from hal.profile_tables import profile_folder
from host_sync.cli import view
from tests.apparatus.printing import needs_browser

DOCS = Path(__file__).parent.parent / "docs"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```|^    ((?:retroscan|retrosync)(?: [^\n]*)?)$", re.MULTILINE | re.DOTALL)
ENDED_BY_CTRL_C = {"retroscan --board twin run"}


def steps(page: str) -> Iterator[tuple[str, str]]:
    """Commands, programs, and files with their names, as a reader types them."""
    text = (DOCS / page).read_text(encoding="utf-8")
    for found in re.finditer(BLOCK, text):
        kind, block, line = found.groups()
        if kind is None:
            yield "command", line
        else:
            named = re.findall(r"`(\w+\.toml)`", text[: found.start()])
            yield (kind if kind == "python" else named[-1]), block


def follow(page: str) -> list[str]:
    """Do what a tutorial says; returns its commands."""
    commands = []
    for kind, text in steps(page):
        if kind == "command":
            program, words = split(re.sub(r"(?<= )~(?=/)", os.environ["HOME"], text))
            commands.append(text.partition("  #")[0].strip())
            assert PROGRAMS[program][1](words) == (130 if commands[-1] in ENDED_BY_CTRL_C else 0), text
        elif kind == "python":
            exec(compile(text, page, "exec", dont_inherit=True), {})  # noqa: S102
        else:
            Path(kind).write_text(text, encoding="utf-8")
    return commands


@pytest.fixture
def newcomer(tmp_path: Path, small_board: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder and home; the twin has fewer pixels; what waits for a person ends at once."""
    shutil.copytree(profile_folder(), tmp_path / "board", ignore=shutil.ignore_patterns("*.md", "*/*"))
    shutil.copy(small_board, tmp_path / "board" / "twin.toml")
    monkeypatch.setattr(board_profile, "profile_folder", lambda: tmp_path / "board")
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)

    def served(_server: uvicorn.Server, sockets: object) -> None:
        assert sockets

    async def shown(app: RetroscanApp) -> None:
        async with app.run_test():
            assert app.screen
            app.exit(return_code=0)

    original = instrument_commands.run_headless

    def interrupted(*arguments: Any) -> None:
        def go_on() -> bool:
            raise KeyboardInterrupt

        original(*arguments[:3], go_on)

    def in_process(*words: str) -> None:
        assert PROGRAMS["retroscan"][1](words) == 0

    monkeypatch.setattr(uvicorn.Server, "run", served)
    monkeypatch.setattr(screens, "require_terminal", lambda: None)
    monkeypatch.setattr(RetroscanApp, "run_async", shown)
    monkeypatch.setattr(instrument_commands, "run_headless", interrupted)
    monkeypatch.setattr(view, "_retroscan", in_process)
    return tmp_path


def put(path: Path, light: Float64Array, seed: int) -> None:
    """A frame as an ordinary camera writes it: sRGB, 8 bit."""
    light = np.clip(light + 0.002 * np.random.default_rng(seed).standard_normal(light.shape), 0.0, 1.0)
    values = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    assert cv2.imwrite(str(path), np.rint(255.0 * values).astype(np.uint8)[..., ::-1])


@pytest.mark.slow
def test_a_height_map_of_own_frames(newcomer: Path) -> None:
    lamps = NearLamps(500.0)
    light = lamps.flat_field() / (2.0 * lamps.flat_field().max())
    put(newcomer / "flat.png", light, 0)
    for number, (column, row) in enumerate([*PLACES, (0.4, 0.45)]):
        ball = Ball(column * SHAPE[1], row * SHAPE[0], 0.6 * RADIUS_PX, RADIUS_PX)
        name = f"ball-{number}.png" if number < len(PLACES) else "part.png"
        put(newcomer / name, light * lamps.intensity(press_px(ball, APEX_PX)).values, 1 + number)
    commands = follow("tutorial-workstation.md")
    assert "retrosync export results/part-7 --to gsf x3p glb --out exported" in commands
    assert {path.suffix for path in (newcomer / "exported").iterdir()} == {".gsf", ".x3p", ".glb"}
    height_um = tifffile.imread(newcomer / "results" / "part-7" / "height_um.tif")
    assert height_um.max() == pytest.approx(50.0 * APEX_PX, rel=0.05)


@needs_browser
@pytest.mark.slow
def test_a_day_with_the_handheld(newcomer: Path) -> None:
    commands = follow("tutorial-field.md")
    assert commands[-1] == "retrosync report --library ~/Retrograph --recipe recipe.toml --out reports"
    assert {path.suffix for path in (newcomer / "reports").iterdir()} == {".html", ".pdf", ".csv"}


def test_every_command_of_a_tutorial_is_run() -> None:
    for page in DOCS.glob("tutorial-*.md"):
        typed = re.findall(r"^ *((?:retroscan|retrosync)\b.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
        assert [text for kind, text in steps(page.name) if kind == "command"] == typed
        assert typed
