"""Readings of balls that a map was not trained on: the material of every statement about how true it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float64Array, MaskArray


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutReadings:
    """Pixels of kept balls, each read by the map trained on the other folds; all share their first axis (N).

    slope, truth : float64 arrays of shape (N, 2), as read and as the sphere at its refined centre has it
    place : float64 array of shape (N, 2), position variables
    ball : int array of shape (N,), number of the ball in the fit
    radius_px : float64 array of shape (balls of the fit,), radii of the spheres
    """

    slope: Float64Array
    truth: Float64Array
    place: Float64Array
    ball: NDArray[np.intp]
    radius_px: Float64Array

    @property
    def tilt_deg(self) -> Float64Array:
        """Tilt of the true surface, degrees, shape (N,)."""
        return np.asarray(np.degrees(np.arctan(np.linalg.norm(self.truth, axis=1))))

    def select(self, rows: MaskArray) -> HeldOutReadings:
        """Those of some pixels, bool array of shape (N,)."""
        return HeldOutReadings(self.slope[rows], self.truth[rows], self.place[rows], self.ball[rows], self.radius_px)
