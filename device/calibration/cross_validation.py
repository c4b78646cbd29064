"""Ridge regression of slope whose every judgement comes from balls that it did not see, and gains of slope by band."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from device.calibration.product_features import ProductFeatures
from device.surface import Float64Array, MaskArray, stereographic_from_slope

FOLDS: Final = 5


@dataclass(frozen=True, slots=True, eq=False)
class GroupedRidgeCV:
    """The features of one polynomial at the pixels of balls.

    features : of N pixels, F of them, which are learned from
    seen : the same of the pixels as they are seen, with their noise, from which held-out slopes are read; None where
        both are the same
    judged : the same with as much noise as a surface keeps, from which forms and penalties are judged; None likewise
    ball : int array of shape (N,), the ball that each pixel belongs to
    prior : float64 array of shape (F, 2), coefficients that the penalty draws towards; None for 0
    anchor : Gram matrix (F, F) and moments (F, 2), less those of the prior, of pixels that are learned beside all
        samples; None for none
    """

    features: ProductFeatures
    ball: NDArray[np.intp]
    prior: Float64Array | None = None
    anchor: tuple[Float64Array, Float64Array] | None = None
    seen: ProductFeatures | None = None
    judged: ProductFeatures | None = None

    def solve(self, penalty: float, slope: Float64Array, weight: Float64Array, alive: MaskArray) -> Float64Array:
        """Return coefficients of shape (F, 2) learned from the living balls.

        slope : float64 array of shape (N, 2), true slopes
        weight : float64 array of shape (N,)
        """
        gram, moment = self._normal_equations(alive[self.ball], slope, weight)
        return self.solution(gram, moment, penalty)

    def leverage_root(
        self, penalty: float, slope: Float64Array, weight: Float64Array, alive: MaskArray
    ) -> Float64Array:
        """Float64 array B of shape (F, F) with B Bᵀ the inverse of the penalised Gram matrix of the living balls."""
        gram, _ = self._normal_equations(alive[self.ball], slope, weight)
        values, vectors = np.linalg.eigh(gram)
        return np.asarray(vectors / np.sqrt(np.maximum(values, 0.0) + self._scale * penalty))

    def held_out(
        self,
        penalties: Sequence[float],
        slope: Float64Array,
        weight: Float64Array,
        alive: MaskArray,
        fold_of_ball: NDArray[np.intp] | None = None,
    ) -> list[Float64Array]:
        """Return the held-out stereographic slopes (N, 2), one array per penalty.

        A ball's slopes come from the living balls of other folds.

        fold_of_ball : int array of shape (balls,), from 0 on; by default balls are dealt out to `FOLDS` in turn
        """
        return self.folds(slope, weight, alive, fold_of_ball).held_out(penalties)

    def folds(
        self,
        slope: Float64Array,
        weight: Float64Array,
        alive: MaskArray,
        fold_of_ball: NDArray[np.intp] | None = None,
    ) -> FoldedRidge:
        """Return the ridge with its normal equations fold by fold, to be solved for any penalties.

        Arguments as for `held_out`.
        """
        fold = self._fold_of_row(alive) if fold_of_ball is None else fold_of_ball[self.ball]
        count = int(fold.max()) + 1
        parts = [self._normal_equations(alive[self.ball] & (fold == number), slope, weight) for number in range(count)]
        gram, moment = (np.sum([part[i] for part in parts], axis=0) for i in (0, 1))
        return FoldedRidge(self, fold, [(gram - own_gram, moment - own_moment) for own_gram, own_moment in parts])

    def _fold_of_row(self, alive: MaskArray) -> NDArray[np.intp]:
        return (np.arange(len(alive)) % min(FOLDS, len(alive)))[self.ball]

    def _normal_equations(
        self, rows: MaskArray, slope: Float64Array, weight: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        wanted = np.asarray(stereographic_from_slope(slope[:, 0], slope[:, 1]), np.float64)
        gram, moment = self.features.normal_equations(np.flatnonzero(rows), weight, wanted)
        if self.prior is not None:
            moment -= gram @ self.prior
        if self.anchor is None:
            return gram, moment
        share = rows.mean()
        return gram + share * self.anchor[0], moment + share * self.anchor[1]

    def solution(self, gram: Float64Array, moment: Float64Array, penalty: float) -> Float64Array:
        """Ridge solution of shape (F, 2).

        A Cholesky factor takes a fraction of a decomposition into eigenvectors, which is only taken where rounding
        leaves a Gram matrix that is not positive.
        """
        from scipy.linalg import cho_factor, cho_solve  # here, because reading a map solves nothing

        drawn_to = 0.0 if self.prior is None else self.prior
        penalised = gram.copy()
        penalised.flat[:: len(gram) + 1] += self._scale * penalty
        try:
            factor = cho_factor(penalised, lower=True, overwrite_a=True, check_finite=False)
            return np.asarray(drawn_to + cho_solve(factor, moment, check_finite=False))
        except LinAlgError:
            values, vectors = np.linalg.eigh(gram)
            turned = vectors.T @ moment / (np.maximum(values, 0.0) + self._scale * penalty)[:, None]
            return np.asarray(drawn_to + vectors @ turned)

    @property
    def _scale(self) -> float:
        """Return the factor of a penalty that makes it independent of the number of samples."""
        return len(self.ball) / 100.0


@dataclass(frozen=True, slots=True, eq=False)
class FoldedRidge:
    """A ridge whose folds' normal equations are known.

    fold : int array of shape (N,), the fold of each pixel
    others : of every fold, the Gram matrix and the moments of the living balls of all others
    """

    ridge: GroupedRidgeCV
    fold: NDArray[np.intp]
    others: list[tuple[Float64Array, Float64Array]]

    def held_out(self, penalties: Sequence[float], *, judged: bool = False) -> list[Float64Array]:
        """Return the held-out stereographic slopes (N, 2), one array per penalty.

        A ball's slopes come from the living balls of other folds.

        judged : of the pixels with as much noise as a surface keeps
        """
        features = (self.ridge.judged if judged else self.ridge.seen) or self.ridge.features
        predictions = np.zeros((len(penalties), len(self.fold), 2))
        for number, (gram, moment) in enumerate(self.others):
            rows = np.flatnonzero(self.fold == number)
            solutions = [self.ridge.solution(gram, moment, penalty) for penalty in penalties]
            together = features.times(rows, np.concatenate(solutions, axis=1))
            predictions[:, rows] = together.reshape(len(rows), len(penalties), 2).swapaxes(0, 1)
        return list(predictions)


def balanced_errors(ball: NDArray[np.intp], slopes: Float64Array, truth: Float64Array) -> list[float]:
    """Return the mean absolute errors of slopes (P, N, 2) about each ball's median error.

    Errors of a ball's centre then do not count.

    ball : int array of shape (N,), index of the ball that a pixel belongs to
    """
    errors = slopes - truth
    for number in np.unique(ball):
        rows = np.flatnonzero(ball == number)
        own = errors[:, rows]
        errors[:, rows] = own - np.median(own, axis=1, keepdims=True)
    return [float(np.abs(error).mean()) for error in errors]


def angle_between_deg(slope: Float64Array, truth: Float64Array) -> Float64Array:
    """Return the angle between the normals of slopes of shape (N, 2), degrees, shape (N,)."""
    dot = (slope * truth).sum(axis=-1) + 1.0
    norms = np.sqrt((1.0 + (slope**2).sum(axis=-1)) * (1.0 + (truth**2).sum(axis=-1)))
    return np.asarray(np.degrees(np.arccos(np.clip(dot / norms, -1.0, 1.0))))


def robust_weight(slope: Float64Array, truth: Float64Array) -> Float64Array:
    """Return weights of shape (N,), mean 1, that turn the next least-squares pass towards least absolute error."""
    residual = np.linalg.norm(stereographic_from_slope(*slope.T) - stereographic_from_slope(*truth.T), axis=1)
    weight = 1.0 / np.maximum(residual, max(0.5 * float(np.median(residual)), 1e-6))
    return np.asarray(weight / weight.mean())


# Gain band by band: by what factor slopes are read too steep or too flat.
#
# The gain of a band is the slope of the line through (true, read) of its pixels. Noise of the reading does not flatten
# a line on the truth, but an error of the truth would: so each ball's true slopes are first moved by the mean by which
# its own readings differ, which is what its centre is off. The standard uncertainty is the jackknife's over balls.

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
