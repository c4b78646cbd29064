"""By what factor slopes are read too steep or too flat, estimated on the true slope, band by band.

The gain of a band is the slope of the line through (true, read) of its pixels. Noise of the reading does not flatten a
line on the truth, but an error of the truth would: so each ball's true slopes are first moved by the mean by which its
own readings differ, which is what its centre is off. The standard uncertainty is the jackknife's over balls.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface import Float64Array, MaskArray

BAND_EDGES_DEG: Final = (0.0, 3.0, 8.0, 15.0, 30.0)
MIN_PIXELS: Final = 50
"""In a band, for its gain to be given."""


@dataclass(frozen=True, slots=True)
class SlopeGain:
    """Gain of the slopes whose surface is tilted between two angles, 1 where they are read right.

    sigma : its standard uncertainty, None where one ball alone shows the band
    """

    from_deg: float
    to_deg: float
    gain: float
    sigma: float | None
    pixels: int


def slope_gains(readings: HeldOutReadings) -> tuple[SlopeGain, ...]:
    """Return the gain of every band that enough pixels show."""
    centred = _centred(readings)
    tilt = centred.tilt_deg
    bands = [(low, high, (tilt >= low) & (tilt < high)) for low, high in pairwise(BAND_EDGES_DEG)]
    return tuple(_gain(low, high, centred.select(rows)) for low, high, rows in bands if rows.sum() >= MIN_PIXELS)


def _centred(readings: HeldOutReadings) -> HeldOutReadings:
    """Return the readings with every ball's truth where its own readings put its centre."""
    count = np.maximum(np.bincount(readings.ball), 1)
    off = [np.bincount(readings.ball, part) / count for part in (readings.slope - readings.truth).T]
    return replace(readings, truth=readings.truth + np.stack(off, axis=-1)[readings.ball])


def _gain(low: float, high: float, readings: HeldOutReadings) -> SlopeGain:
    """Return the ratio of sums over balls of Σ read · true and Σ true · true, both less the ball's means."""
    sums = np.array([_sums(readings, number) for number in np.unique(readings.ball)])
    total = sums.sum(axis=0)
    sigma = None
    if len(sums) > 1:
        left_out = _ratios(total - part for part in sums)
        spread = float(((left_out - left_out.mean()) ** 2).sum())
        sigma = float(np.sqrt((len(sums) - 1) / len(sums) * spread))
    return SlopeGain(low, high, float(total[0] / total[1]), sigma, len(readings.ball))


def gains_of_balls(slope: Float64Array, truth: Float64Array, ball: NDArray[np.intp]) -> Float64Array:
    """Return the gain of each ball that shows enough of these pixels, float64 array of shape (balls,).

    slope, truth : float64 arrays of shape (N, 2)
    ball : int array of shape (N,)
    """
    numbers = np.flatnonzero(np.bincount(ball) >= MIN_PIXELS)
    return _ratios(np.array(_sums_of(slope[ball == number], truth[ball == number])) for number in numbers)


def _sums(readings: HeldOutReadings, number: int) -> tuple[float, float]:
    own = readings.ball == number
    return _sums_of(readings.slope[own], readings.truth[own])


def _sums_of(slope: Float64Array, truth: Float64Array) -> tuple[float, float]:
    """Of one ball: sums of read · true and true · true, both less the mean."""
    true = truth - truth.mean(axis=0)
    return float((slope * true).sum()), float((true * true).sum())


def _ratios(sums: Iterable[Float64Array]) -> Float64Array:
    return np.array([part[0] / max(part[1], 1e-12) for part in sums])


# Readings of balls that a map was not trained on: the material of every statement about how true it is.


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
        """Return those of some pixels, bool array of shape (N,)."""
        return HeldOutReadings(self.slope[rows], self.truth[rows], self.place[rows], self.ball[rows], self.radius_px)
