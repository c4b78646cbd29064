"""Writes what board/ shows of its facts: wiring tables, pin maps, drawings, and what light does.

`make board` runs it; a test compares what is there with what it would write.
"""

from __future__ import annotations

from pathlib import Path

from light_tables import with_tables
from wiring import wired_boards, wiring
from wiring_drawing import drawing
from wiring_table import wiring_page

FOLDER = Path(__file__).parents[2] / "board"


def pages() -> dict[Path, str]:
    """Text of every page and drawing made from board profiles, wiring and physics, by its place below `board/`."""
    made = {}
    for board in wired_boards():
        facts = wiring(board)
        made[Path("wiring") / f"{board}.svg"] = drawing(facts)
        made[Path("wiring") / f"{board}.md"] = wiring_page(facts)
    lights = Path("light-geometry.md")
    made[lights] = with_tables((FOLDER / lights).read_text(encoding="utf-8"))
    return made


def main() -> None:
    """Write them all."""
    for place, text in pages().items():
        (FOLDER / place).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
