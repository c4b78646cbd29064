"""Rigid motions in the plane: where a place of one press lies in another, and in the mosaic.

Places are (row, column), px, from the middle of a press. A turn is clockwise on the screen, as for `Pose`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float64Array

QUARTER: Final = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Derivative of `turning` by its angle, at none."""


def turning(turn: float) -> Float64Array:
    """Return the rotation of places (row, column) by `turn` (rad): float64 array of shape (2, 2)."""
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.array([[cosine, sine], [-sine, cosine]])


@dataclass(frozen=True, slots=True)
class Motion:
    """From places u of one press to places s + M(turn) u of another; also of a press to the mosaic.

    down, right : px
    turn : rad
    """

    down: float = 0.0
    right: float = 0.0
    turn: float = 0.0

    def of(self, places: Float64Array) -> Float64Array:
        """Return where places, an array of shape (…, 2), lie."""
        return np.asarray(places @ turning(self.turn).T + (self.down, self.right), np.float64)

    def then(self, other: Motion) -> Motion:
        """This motion and the other after it."""
        down, right = other.of(np.array([self.down, self.right]))
        return Motion(float(down), float(right), self.turn + other.turn)

    def back(self) -> Motion:
        """Return the inverse motion."""
        down, right = -(turning(-self.turn) @ (self.down, self.right))
        return Motion(float(down), float(right), -self.turn)

    def distance_px(self, other: Motion, reach_px: float) -> float:
        """Return the largest distance between where both put a place up to `reach_px` from the middle, to first
        order."""
        turn = (self.turn - other.turn + np.pi) % (2.0 * np.pi) - np.pi
        return float(np.hypot(self.down - other.down, self.right - other.right) + reach_px * abs(turn))
