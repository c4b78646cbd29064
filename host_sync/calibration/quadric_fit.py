"""A quadratic function of the normal fitted to balls, where it explains them: by least squares, fold by fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Final

import numpy as np

from device.balls.sphere import Ball, BallSamples, gather_samples
from device.calibration.cross_validation import FOLDS, angle_between_deg
from device.calibration.fit import InverseFit
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.illumination import IlluminationMap
from device.inverse_map.polynomial_features import field_position, monomials
from device.surface.fields import Float64Array
from host_sync.kernels.cell_rows import cell_px
from host_sync.lights.normal_quadric import TERMS, FittedQuadric, NormalQuadric, QuadricReader, normal_terms
from host_sync.uncertainty.slope_error import OverCells, ReadsSlopes

DEGREES: Final = (1, 2)
"""Degrees of the coefficients' polynomials in position that are tried, each with and without division by the light of
untouched skin. With degree 3 a dozen balls leave the corners of the field to chance.
"""

MAX_LEFT: Final = 0.05
"""What a quadric may leave of held-out balls' intensity, as a share of their contrast, root mean squares both.

It leaves 0.01 to 0.043 of balls that makers' models render, 0.08 to 0.25 of those under near lamps and on real sensors.
"""

LIGHT_SETS: Final = 0.08
"""Intensity below which a light sets, so that no smooth function holds: not fitted."""

RIDGE: Final = 1e-6
MAX_SAMPLES: Final = 20_000


def quadric_that_reads_better(
    kept: Sequence[tuple[NormalizedImage, Sequence[Ball]]], inverse: InverseFit, light: IlluminationMap | None
) -> tuple[FittedQuadric, OverCells] | None:
    """A quadric, and what reads the balls of `kept` by it; None where it does not explain held-out balls, or the map
    reads them as well.

    light : of untouched skin; None where there is no reference
    """
    if not inverse.replicas:
        return None
    shape = inverse.map.shape
    everything = gather_samples(kept, to_teach=True)
    samples = everything.select(np.random.default_rng(0).permutation(len(everything.p))[:MAX_SAMPLES])
    lights = (None,) if light is None else (None, light)
    lessons = [_Lesson.of(samples, shape, degree, one) for degree in DEGREES for one in lights]
    left, lesson = min(((one.left(), one) for one in lessons), key=itemgetter(0))
    if not left <= MAX_LEFT:
        return None
    errors_deg = np.zeros((2, len(samples.p)))
    truth = np.stack([samples.p, samples.q], axis=-1).astype(np.float64)
    for number, (replica, quadric) in enumerate(zip(inverse.replicas, lesson.folds, strict=True)):
        rows = np.flatnonzero(samples.ball % FOLDS == number)
        some = samples.select(rows)
        readers: tuple[ReadsSlopes, ...] = (replica, QuadricReader(replica, quadric))
        for own, reader in zip(errors_deg, readers, strict=True):
            own[rows] = angle_between_deg(reader.predict(some.taught, some.column, some.row), truth[rows])
    of_map, of_quadric = errors_deg.mean(axis=1)
    if not of_quadric < of_map:
        return None
    fitted = FittedQuadric(lesson.whole, lesson.folds)
    count = sum(len(balls) for _, balls in kept)
    without = [QuadricReader(inverse.map, fitted.folds[ball % FOLDS]) for ball in range(count)]
    return fitted, OverCells(QuadricReader(inverse.map, fitted.model), without, cell_px(shape))


@dataclass(frozen=True, slots=True, eq=False)
class _Lesson:
    """Quadrics of one form, fitted to balls.

    samples : of balls
    whole : learned from all of them
    folds : from all but every `FOLDS`-th ball
    """

    samples: BallSamples
    whole: NormalQuadric
    folds: tuple[NormalQuadric, ...]

    @classmethod
    def of(cls, samples: BallSamples, shape: tuple[int, int], degree: int, light: IlluminationMap | None) -> _Lesson:
        """The quadrics of this degree."""
        place = field_position(samples.column.astype(np.float64), samples.row.astype(np.float64), shape)
        by_normal = normal_terms(np.stack([samples.p, samples.q], axis=-1).astype(np.float64))
        by_place = monomials(place, degree)
        design = (by_normal[:, :, None] * by_place[:, None, :]).reshape(len(place), -1)
        over = np.ones((len(place), 3)) if light is None else light.at(place).astype(np.float64)
        fold = samples.ball % FOLDS
        grams, moments = np.zeros((FOLDS, 3, design.shape[1], design.shape[1])), np.zeros((FOLDS, 3, design.shape[1]))
        for number in range(FOLDS):
            for channel in range(3):
                rows = np.flatnonzero((fold == number) & (samples.taught[:, channel] > LIGHT_SETS))
                terms = design[rows] / over[rows, channel, None]
                grams[number, channel] = terms.T @ terms
                moments[number, channel] = terms.T @ (samples.taught[rows, channel] - 1.0)
        ridge = RIDGE * len(place) * np.eye(design.shape[1])

        def solved(left_out: int | None) -> NormalQuadric:
            known = [number for number in range(FOLDS) if number != left_out]
            gram, moment = grams[known].sum(axis=0) + ridge, moments[known].sum(axis=0)
            found = np.linalg.solve(gram, moment[..., None])[..., 0]
            coefficients = np.ascontiguousarray(found.reshape(3, TERMS, -1).transpose(1, 2, 0))
            return NormalQuadric(shape, degree, coefficients, light)

        return cls(samples, solved(None), tuple(solved(number) for number in range(FOLDS)))

    def left(self) -> float:
        """What is left of held-out balls' intensity, as a share of their contrast to level skin."""
        squares: list[Float64Array] = []
        for number, quadric in enumerate(self.folds):
            some = self.samples.select(np.flatnonzero(self.samples.ball % FOLDS == number))
            skin = quadric.at(some.column.astype(np.float64), some.row.astype(np.float64))
            shown = skin.shown(np.stack([some.p, some.q], axis=-1).astype(np.float64))
            squares.append((shown - some.taught).ravel() ** 2)
        contrast = np.square(self.samples.taught - 1.0).mean()
        return float(np.sqrt(np.concatenate(squares).mean() / max(contrast, 1e-12)))
