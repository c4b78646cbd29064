"""Writes everything to order the boards with into build/board: `make board` runs it."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.drawings.pcb.designs import carrier, light
from tests.drawings.pcb.fabrication import files
from tests.drawings.pcb.kicad import kicad_board
from tests.drawings.pcb.rules import complaints

FOLDER = Path(__file__).parents[3] / "build" / "board"


def main() -> int:
    """Write the files of both boards; refuse a board that breaks a rule."""
    for board in (carrier(), light()):
        wrong = complaints(board)
        if wrong:
            sys.stderr.write("\n".join([f"{board.name} breaks {len(wrong)} rules, nothing is written:", *wrong, ""]))
            return 1
        place = FOLDER / board.name
        place.mkdir(parents=True, exist_ok=True)
        for name, text in {**files(board), f"{board.name}.kicad_pcb": kicad_board(board)}.items():
            (place / name).write_text(text, encoding="utf-8")
        joined = sum(len(pins) for pins in board.nets().values())
        size = f"{board.size[0]:g} x {board.size[1]:g} mm"
        sys.stdout.write(
            f"{place.relative_to(FOLDER.parents[1])}: {size}, {len(board.parts)} parts, {joined} pins on "
            f"{len(board.nets())} nets, {len(board.tracks)} tracks, {len(board.vias)} vias\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
