"""A grid of terminal cells, into which every picture is drawn, and the colours that a terminal has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

OWN: Final = -1
"""The terminal's default colour."""

BLACK, SILVER, GREY, WHITE = 0, 7, 8, 15
"""Numbers of the four greys among a console's sixteen colours."""


ColourDepth = Literal["full", "sixteen", "mono"]
"""Any colour, the sixteen of a plain console, or none."""

_MONO: Final = ("", "dumb", "unknown", "vt100", "vt102", "vt220")


@dataclass(frozen=True, slots=True, eq=False)
class CellGrid:
    """Glyphs and their colours, drawn in place.

    glyphs : '<U1' array of shape (rows, columns)
    ink, paper : int32 arrays of the same shape; 0xRRGGBB in full colour, 0 to 15 in sixteen, `OWN` for the default
    bold : bool array of the same shape
    depth : which colours are meant
    """

    glyphs: NDArray[np.str_]
    ink: NDArray[np.int32]
    paper: NDArray[np.int32]
    bold: NDArray[np.bool_]
    depth: ColourDepth

    @classmethod
    def empty(cls, rows: int, columns: int, depth: ColourDepth) -> CellGrid:
        """A grid of spaces in the terminal's default colours."""
        shape = (max(rows, 0), max(columns, 0))
        own = np.full(shape, OWN, np.int32)
        return cls(np.full(shape, " ", "<U1"), own, own.copy(), np.zeros(shape, np.bool_), depth)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        rows, columns = self.glyphs.shape
        return rows, columns

    def write(self, row: int, column: int, text: str, bold: bool = False) -> None:
        """Write text on a row in the default colours; it is clipped to the grid."""
        rows, columns = self.shape
        if not 0 <= row < rows:
            return
        for place, glyph in enumerate(text, start=column):
            if 0 <= place < columns:
                self.glyphs[row, place] = glyph
                self.ink[row, place] = self.paper[row, place] = OWN
                self.bold[row, place] = bold

    def blit(self, row: int, column: int, part: CellGrid) -> None:
        """Copy another grid here; it is clipped to this one."""
        rows, columns = (min(size, room) for size, room in zip(part.shape, self._room(row, column), strict=True))
        here = np.s_[row : row + rows, column : column + columns]
        there = np.s_[:rows, :columns]
        self.glyphs[here], self.ink[here] = part.glyphs[there], part.ink[there]
        self.paper[here], self.bold[here] = part.paper[there], part.bold[there]

    def lines(self) -> list[str]:
        """The glyphs of each row."""
        return ["".join(row) for row in self.glyphs]

    def _room(self, row: int, column: int) -> tuple[int, int]:
        rows, columns = self.shape
        return max(rows - row, 0), max(columns - column, 0)


def colour_depth(environment: Mapping[str, str]) -> ColourDepth:
    """The colours of a terminal, from its environment variables: none with NO_COLOR, sixteen by default."""
    term = environment.get("TERM", "")
    if environment.get("NO_COLOR") or term in _MONO:
        return "mono"
    promised = environment.get("COLORTERM", "").lower() in {"truecolor", "24bit"}
    return "full" if promised or term.endswith("256color") or "kitty" in term else "sixteen"
