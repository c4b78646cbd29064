"""By how much each channel's light differs from the calibration's, with and without untouched skin in the frame.

Untouched skin differs from the reference by one factor a channel, everywhere alike: where enough of the field agrees on
the three factors, those are the levels. Without untouched skin the levels are what a robust fit leaves over,

    log I_k(x, y) = γ_k + D_k(x, y)·t + relief,

with t a tilt of the whole field that a gel of this depth allows, D the light's response to slope as the balls showed
it, and relief whatever the object adds: that averages out over the field, and how well is part of the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.surface import Float32Array, Float64Array, MaskArray

CELLS_ACROSS: Final = 48
SAMPLES_ALONG: Final = 512
"""Cells of the field, and the rows and columns of which they are the mean, about."""

AGREEING: Final = 0.01
AGREEING_PER_CHANGE: Final = 0.12
"""Cells of untouched skin agree on the log level of a channel to this, and by so much of the change itself: what
filters pass of other lights differs over the field."""

MIN_AGREEING: Final = 0.08
"""Fraction of the field's cells that must agree to be called untouched."""

CANDIDATES: Final = 6
GENTLE: Final = 0.25
"""Slopes up to which the light's response to slope is fitted."""

ROUNDS: Final = 12
CAUCHY: Final = 2.4
"""Deviations of a cell, in standard deviations, at which its weight has fallen to a half."""


@dataclass(frozen=True, slots=True, eq=False)
class SlopeResponse:
    """Response of log intensity to slope near zero, and to elevation.

    terms : float64 array of shape (3, 2, 3): for 1, x and y (-1 to 1 over the field) D's two components by channel
    raised : standard deviation of log intensity, all channels alike, at the apexes of balls, which have no slope
    tilt : standard deviation of the slope of the whole field that the balls' depth allows
    """

    terms: Float64Array
    raised: float
    tilt: float

    @classmethod
    def of(cls, samples: BallSamples, balls: list[Ball], shape: tuple[int, int]) -> SlopeResponse | None:
        """Return the response that balls show in a field (H, W); None where too few pixels have a gentle slope."""
        gentle = np.flatnonzero(np.hypot(samples.p, samples.q) < GENTLE)
        gentle = gentle[:: max(1, gentle.size // 40_000)]
        if gentle.size < 200:
            return None
        slope = np.stack([samples.p[gentle], samples.q[gentle]], axis=-1).astype(np.float64)
        place = _place(samples.column[gentle], samples.row[gentle], shape)
        features = (place[:, :, None] * slope[:, None, :]).reshape(-1, 6)
        square = (slope**2).sum(axis=1, keepdims=True)
        light = np.log(np.maximum(samples.intensity[gentle], DARK_FLOOR))
        ball = samples.ball[gentle]
        own = (ball[:, None] == np.unique(ball)[None, :]).astype(np.float64)
        found = np.linalg.lstsq(np.hstack([features, square, own]), light, rcond=None)[0]
        apex = found[7:].mean(axis=1)
        depth = max(b.radius_px - np.sqrt(max(b.radius_px**2 - b.contact_radius_px**2, 0.0)) for b in balls)
        return cls(found[:6].reshape(3, 2, 3), float(np.sqrt((apex**2).mean())), 2.0 * float(depth) / max(shape))

    def at(self, shape: tuple[int, int]) -> Float64Array:
        """D over an image of cells of shape (h, w): float64 array of shape (h · w, 2, 3)."""
        row, column = (grid.ravel() for grid in np.mgrid[: shape[0], : shape[1]])
        return np.tensordot(_place(column, row, shape), self.terms, axes=1)


@dataclass(frozen=True, slots=True, eq=False)
class LevelSight:
    """Log levels of the three channels over the reference's.

    levels : float64 array of shape (3,)
    covariance : float64 array of shape (3, 3)
    untouched : fraction of the field that agrees on them; 0 when no untouched skin was found
    """

    levels: Float64Array
    covariance: Float64Array
    untouched: float


def cell_logs(image: NormalizedImage) -> Float32Array:
    """Return the log intensity of the field's cells: float32 array of shape (h, w, 3)."""
    step = max(1, image.shape[1] // SAMPLES_ALONG)
    values = np.ascontiguousarray(image.values[step // 2 :: step, step // 2 :: step])
    cells = cv2.resize(values, cells_shape(image.shape)[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(np.log(np.maximum(cells, np.float32(DARK_FLOOR))), np.float32)


def cells_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return rows and columns of cells of a field of `shape` (H, W)."""
    width = min(CELLS_ACROSS, shape[1] // 2)
    return max(2, round(shape[0] * width / shape[1])), width


def untouched_levels(cells: Float32Array) -> list[LevelSight]:
    """Return the levels on which large parts of the field agree that reach its border, the largest part first."""
    flat = cells.reshape(-1, 3).astype(np.float64)
    border = _border(cells.shape[:2]).ravel()
    bins, counts = np.unique(np.floor(flat / AGREEING).astype(np.int64), axis=0, return_counts=True)
    found: list[LevelSight] = []
    for start in bins[np.argsort(counts)[::-1][:CANDIDATES]]:
        level = (start + 0.5) * AGREEING
        agreeing = _agreeing(flat, level, 1.5)
        for _ in range(4):
            if not agreeing.any():
                break
            level = np.median(flat[agreeing], axis=0)
            agreeing = _agreeing(flat, level, 1.0)
        fraction = float(agreeing.mean())
        new = all(np.abs(level - other.levels).max() > 2.0 * AGREEING for other in found)
        if fraction >= MIN_AGREEING and new and (agreeing & border).any():
            spread = np.cov(flat[agreeing].T) / max(agreeing.sum() / 4.0, 1.0)
            found.append(LevelSight(level, spread + np.eye(3) * 1e-6, fraction))
    return sorted(found, key=lambda sight: -sight.untouched)


def pressed_levels(cells: Float32Array, response: SlopeResponse) -> LevelSight:
    """Return the levels of a frame without untouched skin, by the robust fit."""
    light = cells.reshape(-1, 3).astype(np.float64)
    answer = response.at(cells.shape[:2])
    count = len(light)
    # Unknowns: three levels, two slopes. Cells are small beside what is pressed: a fourth of them is independent.
    design = np.zeros((count, 3, 5))
    design[:, range(3), range(3)] = 1.0
    design[:, :, 3:] = answer.transpose(0, 2, 1)
    prior = np.diag([0.0, 0.0, 0.0, response.tilt**-2, response.tilt**-2])
    weight, inverse = np.ones(count), np.eye(3) / 0.05**2
    for _ in range(ROUNDS):
        normal = np.einsum("n,nia,ij,njb->ab", weight, design, inverse, design, optimize=True) / 4.0 + prior
        right = np.einsum("n,nia,ij,nj->a", weight, design, inverse, light, optimize=True) / 4.0
        solution = np.linalg.solve(normal, right)
        left = light - design @ solution
        scatter = np.einsum("n,ni,nj->ij", weight, left, left) / weight.sum()
        inverse = np.linalg.inv(scatter + np.eye(3) * 1e-6)
        distance = np.einsum("ni,ij,nj->n", left, inverse, left) / 3.0
        weight = 1.0 / (1.0 + distance / CAUCHY**2)
    covariance = np.linalg.inv(normal)[:3, :3] + response.raised**2
    return LevelSight(solution[:3], covariance, 0.0)


def _agreeing(flat: Float64Array, level: Float64Array, wider: float) -> MaskArray:
    allowed = wider * (AGREEING + AGREEING_PER_CHANGE * float(np.abs(level).max()))
    return np.asarray((np.abs(flat - level) < allowed).all(axis=1))


def _border(shape: tuple[int, ...]) -> MaskArray:
    """True for the two outermost rows and columns of cells."""
    border = np.ones(shape, np.bool_)
    border[2:-2, 2:-2] = False
    return border


def _place(column: Float32Array, row: Float32Array, shape: tuple[int, ...]) -> Float64Array:
    """1, x, y of shape (N, 3), x and y from -1 to 1 over a field of that shape."""
    across = (2.0 * np.asarray(column, np.float64) + 1.0) / shape[1] - 1.0
    down = (2.0 * np.asarray(row, np.float64) + 1.0) / shape[0] - 1.0
    return np.stack([np.ones_like(across), across, down], axis=-1)
