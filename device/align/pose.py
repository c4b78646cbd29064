"""Poses in the plane: where a place of one press lies in another, or in a mosaic.

Places are (row, column) from the middle of a press, in any one unit of length. A turn is clockwise on the screen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from device.surface.fields import Float64Array

QUARTER: Final = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Derivative of `turning` by its angle, at none."""


def turning(turn: float) -> Float64Array:
    """Return the rotation of places (row, column) by `turn` (rad): float64 array of shape (2, 2)."""
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.array([[cosine, sine], [-sine, cosine]])


@dataclass(frozen=True, slots=True)
class Pose:
    """Shift and turn that lead from places u of one press to places s + M(turn) u of another, or of a mosaic.

    down, right : the shift s, in the unit of the places, mostly px
    turn : rad
    """

    down: float = 0.0
    right: float = 0.0
    turn: float = 0.0

    def of(self, places: ArrayLike) -> Float64Array:
        """Return where places, an array of shape (…, 2), lie."""
        return np.asarray(places) @ turning(self.turn).T + (self.down, self.right)

    def then(self, other: Pose) -> Pose:
        """Return this pose and the other after it as one."""
        down, right = other.of((self.down, self.right))
        return Pose(float(down), float(right), self.turn + other.turn)

    def back(self) -> Pose:
        """Return the inverse pose."""
        return Pose(-self.down, -self.right).then(Pose(turn=-self.turn))

    def moved_by(self, down: float, right: float, turn: float = 0.0) -> Pose:
        """Return the pose with this added to its shift and turn."""
        return Pose(float(self.down + down), float(self.right + right), float(self.turn + turn))

    def in_units_of(self, length: float) -> Pose:
        """Return the same pose of places in another unit, whose length is given in the present one."""
        return Pose(float(self.down / length), float(self.right / length), self.turn)

    def distance(self, other: Pose, reach: float) -> float:
        """Return the largest distance between the places of a point by either pose, to first order.

        reach : distance of the farthest point from the middle
        """
        turn = (self.turn - other.turn + np.pi) % (2.0 * np.pi) - np.pi
        return float(np.hypot(self.down - other.down, self.right - other.right) + reach * abs(turn))

    def distance_at(self, other: Pose, place: tuple[float, float]) -> float:
        """Return the distance between where both put a place."""
        return float(np.hypot(*(self.of(place) - other.of(place))))
