"""The task to cover an area: what each press adds, as a map, and as a sentence with the way to the next press."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from device.align import turning
from device.guidance.placement import Placement, Target, Unplaced, way_words
from device.surface import Float64Array, HeightMap, MaskArray

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
        """Return the area in lines of text: # covered, · missing, o the middle of the last press.

        Characters are twice as high as wide; at most so many columns and rows.
        """
        height, width = self.covered.shape
        step = max(-(-width // columns), 1 if rows is None else -(-height // (2 * rows)))
        cells: Any = np.where(self.covered[step // 2 :: step, step // 2 :: step][::2], "#", "·")
        column, row = (min(max(int(at * n), 0), n - 1) for at, n in zip(self.last, cells.shape[::-1], strict=True))
        cells[row, column] = "o"
        return ["".join(line) for line in cells]


class CoverTask:
    """An area that is covered press by press; the first press that shows a relief is its upper left corner.

    width_mm, height_mm : of the area, above 0 and at most `MAX_AREA_MM`

    `pose` is where the last press stood, or why that is unknown; `way` leads from the last press that was placed to
    the next, mm to the right and down, None where nothing is missing.
    """

    def __init__(self, width_mm: float, height_mm: float) -> None:
        self._size_mm = width_mm, height_mm
        self._covering: Covering | None = None
        self.pose: InstrumentPose | Unplaced | None = None
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
            self.pose = Unplaced("this press shows no relief")
            return
        if self._covering is None:
            self._covering = Covering(*self._size_mm, height)
            self.pose = self._covering.poses[0]
        else:
            self.pose = self._covering.add(height)
        self._unplaced = self._unplaced + 1 if isinstance(self.pose, Unplaced) else 0
        place = self._covering.next_place()
        self.way = self._covering.poses[-1].way_to(place) if place else None

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
        return right, down, -self._covering.poses[-1].clockwise_deg

    def map(self) -> CoverMap | None:
        """Return what is covered now; None before the first press."""
        if (covering := self._covering) is None:
            return None
        last = covering.poses[-1]
        right, down = (
            (at + 0.5 * field) / area
            for at, field, area in zip((last.right_mm, last.down_mm), covering.field_mm, covering.area_mm, strict=True)
        )
        return CoverMap(covering.covered.copy(), (right, down))

    def sentence(self) -> str:
        """Return what is covered, how far the last press overlaps those before it, and what to do, for people."""
        if self.pose is None:
            return FIRST_PRESS
        if self._covering is None:
            return "Press the upper left corner again."
        area = f"{self.share:.0%} of {self._covering.area_mm[0]:.0f} x {self._covering.area_mm[1]:.0f} mm"
        if self.way is None:
            return f"Covered: {area}."
        next_press = way_words(*self.way, LEAST_MM) or "nothing"
        if isinstance(self.pose, Unplaced):
            return f"Covered {area}. Place unknown: {self.pose.reason}. From the last known press move {next_press}."
        turn_deg = self.pose.clockwise_deg
        turn = f", turn {abs(turn_deg):.0f}° {'anti' if turn_deg > 0.0 else ''}clockwise"
        straight = turn if abs(turn_deg) > 1.5 else ""
        overlap = f", overlap {self.pose.overlap:.0%}" if len(self._covering.poses) > 1 else ""
        return f"Covered {area}{overlap}. Move {next_press}{straight}."


# Covering an area press by press: what is covered, and the way to the next press, which must overlap an earlier one.
#
# The first press stands at the area's upper left corner and gives the directions. Every further press is placed against
# the earlier ones (`placement`); one that cannot be placed covers nothing.

CELL_MM: Final = 0.5
"""Side of the cells that the area is divided into."""

WANTED_OVERLAP: Final = 0.4
"""Of the field with one earlier press: a hand misses its place, and the workstation's mosaic needs a quarter."""

MISSED_MM: Final = 1.0
"""A hand is sent so far over the area's border at most: by so much it misses a place."""

SLIVER: Final = 0.01
"""Fraction of a field that is not worth a press."""


@dataclass(frozen=True, slots=True)
class InstrumentPose:
    """Place and turn of the instrument during a press.

    right_mm, down_mm : its middle, from that of the first press, in the first press's directions
    clockwise_deg : its turn from the first press
    overlap : fraction of the field that an earlier press shows too; 1 for the first
    """

    right_mm: float
    down_mm: float
    clockwise_deg: float
    overlap: float

    def of_press(self, placed: Placement) -> InstrumentPose:
        """Return the pose of a press from which `placed` leads here."""
        turn_deg = self.clockwise_deg - placed.clockwise_deg
        right, down = (placed.right_mm, placed.down_mm) @ turning(np.radians(turn_deg))
        return InstrumentPose(float(self.right_mm - right), float(self.down_mm - down), turn_deg, placed.overlap)

    def way_to(self, place_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the way to a place, mm to the right and down in the live view of this press."""
        way = place_mm[0] - self.right_mm, place_mm[1] - self.down_mm
        right, down = way @ turning(-np.radians(self.clockwise_deg))
        return float(right), float(down)


class Covering:
    """An area that is being covered.

    width_mm, height_mm : of the area; it is as large as the field at least
    first : quick look of the press at its upper left corner
    """

    def __init__(self, width_mm: float, height_mm: float, first: HeightMap) -> None:
        rows, columns = first.z_um.shape
        self.field_mm = columns * first.pitch_um * 1e-3, rows * first.pitch_um * 1e-3
        self.area_mm = max(width_mm, self.field_mm[0]), max(height_mm, self.field_mm[1])
        right, down = (
            (np.arange(round(area / CELL_MM)) + 0.5) * CELL_MM - 0.5 * field
            for area, field in zip(self.area_mm, self.field_mm, strict=True)
        )
        self._cells = np.stack(np.meshgrid(right, down), axis=-1)
        self._field_cells = float(np.prod(self.field_mm)) / CELL_MM**2
        self._worth = np.exp2(-2.0 * self._cells[..., 1] / self.field_mm[1])
        self.covered: MaskArray = np.zeros(self._cells.shape[:2], np.bool_)
        self.poses: list[InstrumentPose] = []
        self._targets: list[Target] = []
        self._add(first, InstrumentPose(0.0, 0.0, 0.0, 1.0))

    @property
    def share(self) -> float:
        """Fraction of the area that is covered."""
        return float(self.covered.mean())

    def add(self, height: HeightMap) -> InstrumentPose | Unplaced:
        """Place a press against the earlier ones, the last one first, and count what it covers.

        Where another one turns out to share more with it, that one says where it stood.
        """
        found: InstrumentPose | Unplaced = Unplaced("no earlier press")
        for number in reversed(range(len(self.poses))):
            found = self._placed(height, number)
            if isinstance(found, InstrumentPose):
                shared = [self._overlap(np.array([found.right_mm, found.down_mm]), pose) for pose in self.poses]
                nearest = int(np.argmax(shared))
                again = found if nearest == number else self._placed(height, nearest)
                return self._add(height, again if isinstance(again, InstrumentPose) else found)
        return found

    def next_place(self) -> tuple[float, float] | None:
        """Return the middle of the field that covers most with enough overlap, right and down.

        It is in mm from the first press's middle. What lies further up counts for more, so that rows are filled one
        after the other; of places that are worth as much, the nearest to the last press. None where nothing is left but
        slivers that a hand misses.
        """
        reaches = (
            np.arange(-MISSED_MM, area - field + MISSED_MM + CELL_MM, CELL_MM)
            for area, field in zip(self.area_mm, self.field_mm, strict=True)
        )
        middles = np.stack(np.meshgrid(*reaches), axis=-1)
        new = self._counted(middles, np.ones_like(self._worth))
        last = self.poses[-1]
        away = np.hypot(middles[..., 0] - last.right_mm, middles[..., 1] - last.down_mm)
        enough = np.zeros(new.shape, np.bool_)
        for pose in self.poses:
            enough |= self._overlap(middles, pose) >= WANTED_OVERLAP
        enough &= new >= SLIVER * self._field_cells
        worth = np.where(enough, self._counted(middles, self._worth) - 1e-3 * away, -np.inf)
        row, column = np.unravel_index(int(worth.argmax()), worth.shape)
        if not np.isfinite(worth[row, column]):
            return None
        right, down = middles[row, column].tolist()
        return right, down

    def _placed(self, height: HeightMap, number: int) -> InstrumentPose | Unplaced:
        found = self._targets[number].place(height)
        return self.poses[number].of_press(found) if isinstance(found, Placement) else found

    def _add(self, height: HeightMap, pose: InstrumentPose) -> InstrumentPose:
        self._targets.append(Target(height))
        self.poses.append(pose)
        way = self._cells - (pose.right_mm, pose.down_mm)
        offset = np.abs(way @ turning(-np.radians(pose.clockwise_deg)))
        self.covered |= (offset[..., 0] <= 0.5 * self.field_mm[0]) & (offset[..., 1] <= 0.5 * self.field_mm[1])
        return pose

    def _counted(self, middles: Float64Array, worth: Float64Array) -> Float64Array:
        """Return the worth of the cells that fields with these middles, (h, w, 2), would newly cover, summed."""
        rows, columns = self.covered.shape
        missing = np.zeros((rows + 1, columns + 1))
        missing[1:, 1:] = (worth * ~self.covered).cumsum(axis=0).cumsum(axis=1)
        start = np.rint(middles / CELL_MM)
        end = start + np.rint(np.array(self.field_mm) / CELL_MM)
        (left, top), (right, bottom) = (
            np.moveaxis(np.clip(at, 0, (columns, rows)).astype(np.intp), -1, 0) for at in (start, end)
        )
        return np.asarray(missing[bottom, right] - missing[top, right] - missing[bottom, left] + missing[top, left])

    def _overlap(self, middles: Float64Array, pose: InstrumentPose) -> Float64Array:
        """Return fractions that fields with these middles, (..., 2), share with a press, turns left aside."""
        apart = np.abs(middles - (pose.right_mm, pose.down_mm)) / self.field_mm
        return np.asarray(np.clip(1.0 - apart, 0.0, None).prod(axis=-1))
