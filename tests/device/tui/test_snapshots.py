"""Every screen at both panel sizes and without colour, compared with stored snapshots.

A snapshot is the text of the cells with its numbers, so that it survives a new textual or another terminal's colours.
After an intended change: `UPDATE_SNAPSHOTS=1 pytest tests/device/tui/test_snapshots.py`, then read the difference.
"""

import os
import re
from collections.abc import Callable
from itertools import zip_longest
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from rich.segment import Segment

Stage = Any

SNAPSHOTS = Path(__file__).parent / "snapshots"
DRAWN = set("#o. ")
"""Cells of pictures and circles, whose edges move with noise."""

MAX_MOVED = 0.06
"""Maximum fraction of the cells that may be drawn otherwise."""

NUMBER = re.compile(r"\d+(?:\.\d+)?")
TOLERANCE = 0.05
"""Numbers may differ by this fraction or one unit: measured figures differ a little between machines."""

CONSOLE = set(" ▀▄█▌▐░▒▓─│┌┐└┘├┤┼■·•○▲▼←↑→↓…±µ°×") | {chr(code) for code in range(32, 127)}


async def walk(stage: Stage) -> dict[str, list[str]]:
    """Every screen by key presses: its rows by the screen's name."""
    seen = {}
    await stage.object_pressed()
    seen["scan"] = stage.lines()
    await stage.press("p")
    seen["profile"] = stage.lines()
    await stage.press("p", "j")
    seen["sticky"] = stage.lines()
    await stage.press("escape", "3", "g")
    seen["scans"] = stage.lines()
    await stage.press("4", "down", "down")
    seen["set-up"] = stage.lines()
    await stage.press("end", "enter")
    seen["power-off"] = stage.lines()
    await stage.press("n", "2")
    seen["calibrate"] = stage.lines()
    for _ in range(3):
        await stage.press("space")
        await stage.live(2)
    seen["first-press"] = stage.lines()
    return seen


def steady(lines: list[str]) -> str:
    """The screen's text without what differs between machines: device id, room on the disk, and a picture's shades."""
    text = "\n".join(lines)
    text = re.sub(r"rg[0-9a-f]{8}", "rg........", text)
    text = re.sub(r"\d+ scans left", "N scans left", text)
    return re.sub(r"[▀▁▂▃▄▅▆▇█░▒▓]", "#", text) + "\n"


def same_numbers(now: str, agreed: str) -> bool:
    """Whether two lines hold the same numbers within the tolerance."""
    pairs = zip(NUMBER.findall(now), NUMBER.findall(agreed), strict=False)
    return all(abs(float(a) - float(b)) <= max(TOLERANCE * float(b), 0.1 if "." in b else 1.0) for a, b in pairs)


def same_screen(now: str, agreed: str) -> bool:
    """Whether words, numbers and rules are where they were, and the pictures look alike."""
    pairs = list(zip_longest(now.splitlines(), agreed.splitlines(), fillvalue=""))
    width = max(len(line) for pair in pairs for line in pair)
    moved = 0
    for one, other in pairs:
        if not same_numbers(one, other):
            return False
        one, other = (re.sub(r"\d", "9", line) for line in (one, other))
        for a, b in zip(one.ljust(width), other.ljust(width), strict=True):
            if a != b and not (a in DRAWN and b in DRAWN):
                return False
            moved += a != b
    return moved <= MAX_MOVED * width * len(pairs)


@pytest.mark.parametrize(("size", "depth"), [((80, 24), "full"), ((100, 30), "full"), ((80, 24), "mono")])
def test_screens(play: Callable[..., None], root: Path, size: tuple[int, int], depth: str) -> None:
    seen: dict[str, list[str]] = {}

    async def scenario(stage: Stage) -> None:
        seen.update(await walk(stage))

    play(scenario, root, size=size, depth=depth)
    changed = []
    for name, lines in seen.items():
        assert len(lines) == size[1]
        assert all(len(line) <= size[0] for line in lines)
        path = SNAPSHOTS / f"{name}-{size[0]}x{size[1]}-{depth}.txt"
        if os.environ.get("UPDATE_SNAPSHOTS"):
            path.write_text(steady(lines), encoding="utf-8")
        if not same_screen(steady(lines), path.read_text(encoding="utf-8")):
            changed.append(f"{path.name} differs; it is now:\n{steady(lines)}")
    assert "\n".join(changed) == ""


def test_a_screenshot_can_be_exported_in_colour(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        svg = ElementTree.fromstring(stage.app.export_screenshot())  # noqa: S314 (our own)
        fills = {element.get("fill") for element in svg.iter() if element.get("fill")}
        assert len(fills) > 100
        assert "GOOD" in " ".join(svg.itertext())

    play(scenario, root)


def test_a_plain_console_gets_only_glyphs_that_its_font_has(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        for lines in (await walk(stage)).values():
            assert set("".join(lines)) <= CONSOLE

    play(scenario, root, depth="sixteen")


def test_no_colour_reaches_a_terminal_without(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        screen, filters = stage.app.screen, stage.app.get_line_filters()
        for row, line in enumerate(stage.lines()):
            cells = [Segment(glyph, screen.get_style_at(column, row)) for column, glyph in enumerate(line)]
            for line_filter in filters:
                cells = line_filter.apply(cells, screen.background_colors[1])
            for cell in cells:
                colours = (cell.style.color, cell.style.bgcolor) if cell.style else ()
                assert all(colour is None or colour.is_default for colour in colours)

    play(scenario, root, depth="mono")


def test_a_resized_terminal_is_filled_again(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        for size in ((100, 30), (60, 20), (30, 10), (12, 5), (160, 50), (80, 24)):
            await stage.pilot.resize_terminal(*size)
            await stage.live()
            assert len(stage.lines()) == size[1]
            assert stage.lines()[0].startswith(" 1 Scan")
        assert "GOOD #1" in stage.text()
        assert "q quit" in stage.text()

    play(scenario, root)


def test_a_changed_word_or_number_is_noticed_and_noise_is_not() -> None:
    agreed = "GOOD 99 %\n#####oo##\n" + "#########\n" * 8
    assert same_screen(agreed.replace("oo", "#o"), agreed)
    assert same_screen(agreed.replace("99", "98"), agreed)
    assert not same_screen(agreed.replace("99", "89"), agreed)
    assert not same_screen(agreed.replace("GOOD", "GOOF"), agreed)
    assert not same_screen(agreed.replace("#########", "   ######", 4), agreed)
    assert not same_screen(agreed + "one line more\n", agreed)
