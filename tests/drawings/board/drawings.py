"""Writes the generated pages of board/: wiring tables, pin maps, drawings, and tables of light geometry.

`make board` runs it; a test compares its output with the files.
"""

from __future__ import annotations

from pathlib import Path

from tests.drawings.board.block import block_drawing
from tests.drawings.board.light_tables import with_tables
from tests.drawings.board.netlist import netlist_page
from tests.drawings.board.totals import with_total
from tests.drawings.board.wiring import drawn_boards, wiring
from tests.drawings.board.wiring_drawing import drawing
from tests.drawings.board.wiring_table import wiring_page
from tests.drawings.pcb.designs import carrier, light
from tests.drawings.pcb.picture import picture

FOLDER = Path(__file__).parents[3] / "board"


def pages() -> dict[Path, str]:
    """Text of every page and drawing made from board profiles, wiring and physics, by its path below `board/`."""
    made = {}
    for board in drawn_boards():
        facts = wiring(board)
        made[Path("wiring") / f"{board}.svg"] = drawing(facts)
        made[Path("wiring") / f"{board}.md"] = wiring_page(facts)
        made[Path("wiring") / f"{board}.nets.csv"] = netlist_page(facts)
    made[Path("enclosure") / "block.svg"] = block_drawing()
    for design in (carrier(), light()):
        made[Path("pcb") / f"{design.name}.svg"] = picture(design)
    lights = Path("light-geometry.md")
    made[lights] = with_tables((FOLDER / lights).read_text(encoding="utf-8"))
    bill = Path("bill-of-materials.md")
    made[bill] = with_total((FOLDER / bill).read_text(encoding="utf-8"))
    return made


def main() -> None:
    """Write all of them."""
    for place, text in pages().items():
        (FOLDER / place).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
