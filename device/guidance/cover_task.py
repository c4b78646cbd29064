"""The task to cover an area: what each press adds, as a map, and as a sentence with the way to the next press."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from device.guidance.covering import Covering, Stand
from device.guidance.placement import Unplaced, way_words
from device.surface.fields import HeightMap, MaskArray

MAX_AREA_MM: Final = 300.0
"""Each way: some hundreds of presses."""

LEAST_MM: Final = 0.5
"""A way is rounded to what a hand can follow."""

FIRST_PRESS: Final = "Press the area's upper left corner, then push the button."


@dataclass(frozen=True, slots=True, eq=False)
class CoverMap:
    """Covered part of an area.

    covered : bool array of shape (h, w), square cells from the upper left corner
    last : middle of the last press that was placed, as fractions of width and height
    """

    covered: MaskArray
    last: tuple[float, float]

    def lines(self, columns: int, rows: int | None = None) -> list[str]:
        """The area in characters twice as high as wide, in at most so many columns and rows: # covered, · missing, o
        the middle of the last press."""
        height, width = self.covered.shape
        step = max(-(-width // columns), 1 if rows is None else -(-height // (2 * rows)))
        cells: Any = np.where(self.covered[step // 2 :: step, step // 2 :: step][::2], "#", "·")
        column, row = (min(max(int(at * n), 0), n - 1) for at, n in zip(self.last, cells.shape[::-1], strict=True))
        cells[row, column] = "o"
        return ["".join(line) for line in cells]


class CoverTask:
    """An area that is covered press by press; the first press that shows a relief is its upper left corner.

    width_mm, height_mm : of the area, above 0 and at most `MAX_AREA_MM`

    `stand` is where the last press stood, or why that is unknown; `way` leads from the last press that was placed to
    the next, mm to the right and down, None where nothing is missing.
    """

    def __init__(self, width_mm: float, height_mm: float) -> None:
        self._size_mm = width_mm, height_mm
        self._covering: Covering | None = None
        self.stand: Stand | Unplaced | None = None
        self.way: tuple[float, float] | None = None
        self._unplaced = 0

    @property
    def share(self) -> float:
        """Fraction of the area that is covered."""
        return self._covering.share if self._covering else 0.0

    @property
    def is_done(self) -> bool:
        """True if nothing is missing."""
        return self._covering is not None and self.way is None

    def add(self, height: HeightMap | None) -> None:
        """Add a press by its quick look; None: it must be taken again."""
        if height is None:
            self.stand = Unplaced("this press shows no relief")
            return
        if self._covering is None:
            self._covering = Covering(*self._size_mm, height)
            self.stand = self._covering.stands[0]
        else:
            self.stand = self._covering.add(height)
        self._unplaced = self._unplaced + 1 if isinstance(self.stand, Unplaced) else 0
        place = self._covering.next_place()
        self.way = self._covering.stands[-1].way_to(place) if place else None

    @property
    def hand_way(self) -> tuple[float, float, float] | None:
        """Return the way of a hand from the last press, mm right, mm down and degrees clockwise; None: not known.

        From a press that was not placed it goes half of its last way back.
        """
        if self.way is None or self._covering is None:
            return None
        right, down = self.way
        if self._unplaced:
            part = -(0.5**self._unplaced)
            return part * right, part * down, 0.0
        return right, down, -self._covering.stands[-1].clockwise_deg

    def map(self) -> CoverMap | None:
        """Return what is covered now; None before the first press."""
        if (covering := self._covering) is None:
            return None
        last = covering.stands[-1]
        right, down = (
            (at + 0.5 * field) / area
            for at, field, area in zip((last.right_mm, last.down_mm), covering.field_mm, covering.area_mm, strict=True)
        )
        return CoverMap(covering.covered.copy(), (right, down))

    def sentence(self) -> str:
        """Return what is covered, how far the last press overlaps those before it, and what to do, for people."""
        if self.stand is None:
            return FIRST_PRESS
        if self._covering is None:
            return "Press the upper left corner again."
        area = f"{self.share:.0%} of {self._covering.area_mm[0]:.0f} x {self._covering.area_mm[1]:.0f} mm"
        if self.way is None:
            return f"Covered: {area}."
        next_press = way_words(*self.way, LEAST_MM) or "nothing"
        if isinstance(self.stand, Unplaced):
            return f"Covered {area}. Place unknown: {self.stand.reason}. From the last known press move {next_press}."
        turn_deg = self.stand.clockwise_deg
        turn = f", turn {abs(turn_deg):.0f}° {'anti' if turn_deg > 0.0 else ''}clockwise"
        straight = turn if abs(turn_deg) > 1.5 else ""
        overlap = f", overlap {self.stand.overlap:.0%}" if len(self._covering.stands) > 1 else ""
        return f"Covered {area}{overlap}. Move {next_press}{straight}."
