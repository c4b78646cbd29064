"""A grid of terminal cells: what every picture on the screen is drawn into, before any terminal library sees it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.tui.terminal import ColourDepth

OWN: Final = -1
"""The terminal's own colour."""

BLACK, SILVER, GREY, WHITE = 0, 7, 8, 15
"""Numbers of the four greys among the sixteen colours of a console."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Glyphs and their colours; drawing changes them in place.

    glyphs : '<U1' array of shape (rows, columns)
    ink, paper : int32 arrays of the same shape; 0xRRGGBB in full colour, 0 to 15 in sixteen, `OWN` for the terminal's
    bold : bool array of the same shape
    depth : which of these colours are meant
    """

    glyphs: NDArray[np.str_]
    ink: NDArray[np.int32]
    paper: NDArray[np.int32]
    bold: NDArray[np.bool_]
    depth: ColourDepth

    @classmethod
    def blank(cls, rows: int, columns: int, depth: ColourDepth) -> Cells:
        """Nothing but spaces in the terminal's own colours."""
        shape = (max(rows, 0), max(columns, 0))
        own = np.full(shape, OWN, np.int32)
        return cls(np.full(shape, " ", "<U1"), own, own.copy(), np.zeros(shape, np.bool_), depth)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        rows, columns = self.glyphs.shape
        return rows, columns

    def write(self, row: int, column: int, text: str, bold: bool = False) -> None:
        """Put text on a row in the terminal's own colours; what does not fit is left out."""
        rows, columns = self.shape
        if not 0 <= row < rows:
            return
        for place, glyph in enumerate(text, start=column):
            if 0 <= place < columns:
                self.glyphs[row, place] = glyph
                self.ink[row, place] = self.paper[row, place] = OWN
                self.bold[row, place] = bold

    def paste(self, row: int, column: int, part: Cells) -> None:
        """Put another grid's cells here; what lies outside is left out."""
        rows, columns = (min(size, room) for size, room in zip(part.shape, self._room(row, column), strict=True))
        here = np.s_[row : row + rows, column : column + columns]
        there = np.s_[:rows, :columns]
        self.glyphs[here], self.ink[here] = part.glyphs[there], part.ink[there]
        self.paper[here], self.bold[here] = part.paper[there], part.bold[there]

    def lines(self) -> list[str]:
        """The glyphs of each row, for programs that cannot see."""
        return ["".join(row) for row in self.glyphs]

    def _room(self, row: int, column: int) -> tuple[int, int]:
        rows, columns = self.shape
        return max(rows - row, 0), max(columns - column, 0)
