"""Evidence of skin at rest in a frame, against the noise of untouched skin from frame to frame.

The logarithm of a frame's intensity over untouched skin is noise of two kinds. One gain and one offset a channel are
unknowns of every frame, with priors from the calibration's presses: lights drift, ambient light leaks in, two frames of
8 bits differ by part of a level. What is left, cell by cell, has a covariance that the presses show far from their
balls: camera noise, quantisation in dark corners, compression, pigment that moves. A cell whose light lies within that
noise carries no evidence of a slope, and the prior that a membrane rests decides: its slope shrinks to zero by the
factor of James and Stein. Dark corners, where a level is a tenth of the light, are thereby measured as badly as they
are.

Fine texture leaves the mean of a cell alone. The variance within cells, against the same of untouched skin, shows it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import Ball
from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.imaging.frame_light import FrameLight, certain_levels
from device.surface import Float32Array, Float64Array, MaskArray, large_parts

CELLS_ACROSS: Final = 64
MIN_CELLS: Final = 12
"""Cells along the field's columns, and along its shorter side for a model to be made."""

MIN_LIGHT: Final = 0.02
LEAST_LIGHT: Final = 0.1
"""Intensity below which a logarithm says nothing more, and that of untouched skin, at least."""

FREE_RADII: Final = 2.5
"""Distance from a ball's centre, in contact radii, from which skin counts as free."""

MIN_PRESSES: Final = 3
"""Presses with free skin that a covariance is estimated from."""

LEVEL_SIGMA: Final = 0.0003
OFFSET_SIGMA: Final = 0.00005
"""Least standard deviation of a cell's log intensity, and of its light as a fraction of full scale."""

UNKNOWN_SIGMA: Final = 0.02
UNKNOWN_OFFSET_SIGMA: Final = 1.0 / 255.0
"""Standard deviation of a cell's log intensity, and of its light, where no press shows free skin: a level of 8 bits."""

GAIN_SIGMA: Final = 0.005
FRAME_OFFSET_SIGMA: Final = 0.001
"""Least standard deviations of a frame's gains and offsets (fraction of full scale)."""

CELLS_ALIKE: Final = 16.0
"""Neighbouring cells that err together."""

LIT: Final = 0.5
"""Cells brighter than the darkest that can be divided by, over this, are lit."""

ROUNDS: Final = 6
"""Steps of the fit of the noise to presses."""

WIDE_ROUNDS: Final = 3
MAX_ROUNDS: Final = 20
"""Steps of the search for a frame's gains and offsets: the first ones, in which half of the field counts at least half,
and all of them at most."""

SETTLED: Final = LEVEL_SIGMA / 3.0
"""Change of a frame's levels below which the search for them ends."""

OUTLYING: Final = 3.0
"""Standard deviations at which the prior of a gain or offset counts half: a light is replaced, a blind is opened."""

POOLED_CELLS: Final = 2.0
"""Standard deviation, in cells, of the Gaussian of a neighbourhood."""

CAUCHY: Final = 2.0
"""Squared distance per channel at which the weight of a cell in the fit of gains and offsets has fallen to a half."""

SHRINKAGE: Final = 2.5
"""Squared distance per channel up to which a slope shrinks to zero; noise has 1 on average."""

ROUGHNESS_SHRINKAGE: Final = 2.0
"""Shrinkage threshold of the variance within a cell, relative to that of untouched skin."""

RESTING: Final = 0.1
CALM: Final = 0.3
"""Cells whose slopes keep less than this are at rest, and calm: connected calm cells rest at one height."""

MIN_RESTING: Final = 0.02
"""Fraction of a field's cells that must be at rest for the field to have a zero."""


@dataclass(frozen=True, slots=True, eq=False)
class RestEvidence:
    """Evidence of skin at rest in a frame.

    kept : float32 array of shape (h, w), fraction of its slope that a cell keeps: 0 where the light is that of skin at
        rest, towards 1 where it is not
    lit : bool array of shape (h, w), cells whose reference is bright enough to divide by; others count as at rest
    light : of the frame
    gain_sigma : standard deviation of the gains from frame to frame
    """

    kept: Float32Array
    lit: MaskArray
    light: FrameLight
    gain_sigma: float

    @property
    def fraction(self) -> float:
        """Fraction of the field that is at rest."""
        return float((self.kept[self.lit] < RESTING).mean()) if self.lit.any() else 0.0

    @property
    def has_rest(self) -> bool:
        """True where enough of the field is at rest to give it a zero."""
        return bool((self.kept < RESTING).mean() >= MIN_RESTING)


@dataclass(frozen=True, eq=False)
class SkinAtRest:
    """Noise of the light of untouched skin from frame to frame.

    covariance : float32 array of shape (h, w, 3, 3), of the log intensity of cells once gains and offsets are fitted
    pooled : the same of its mean over neighbouring cells, in which white noise averages out and gentle slopes do not
    roughness : float32 array of shape (h, w, 3), variance of log intensity within a cell
    darkness : float32 array of shape (h, w, 3), one over the light of untouched skin (fraction of full scale)
    gain_sigma, offset_sigma : standard deviations of a frame's gain (relative) and offset (fraction of full scale)
    removes_light : gains and offsets were removed from the presses; False where held-out balls did not confirm it
    """

    covariance: Float32Array
    pooled: Float32Array
    roughness: Float32Array
    darkness: Float32Array
    gain_sigma: float
    offset_sigma: float
    removes_light: bool = True

    @classmethod
    def of(
        cls, presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]], flat_field: Float32Array
    ) -> SkinAtRest | None:
        """Return the model that the free skin of presses shows; None where the field is too small for cells.

        presses : intensity of each press and every ball in it; presses without a ball are left out
        flat_field : float32 array of shape (H, W, 3), light of untouched skin
        """
        size = _cells(flat_field.shape[:2])
        if min(size) < MIN_CELLS:
            return None
        darkness = np.reciprocal(np.maximum(_reduced(flat_field, size), np.float32(DARK_FLOOR)))
        dark = darkness.astype(np.float64)
        floor = LEVEL_SIGMA**2 + (OFFSET_SIGMA * dark) ** 2
        wide = UNKNOWN_SIGMA**2 + (UNKNOWN_OFFSET_SIGMA * dark) ** 2
        shown = [(_cell_logs(image, size), _far_from(balls, image.shape, size)) for image, balls in presses if balls]
        shown = [(logs, free) for logs, free in shown if free.mean() > 1.0 / CELLS_ALIKE]
        if len(shown) < MIN_PRESSES:
            rough = np.full(darkness.shape, np.float32(UNKNOWN_SIGMA**2))
            return cls(_diagonal(wide), _diagonal(wide), rough, darkness, UNKNOWN_SIGMA, FRAME_OFFSET_SIGMA)
        free = np.stack([own for _, own in shown]) & (darkness < LIT / DARK_FLOOR).all(axis=-1)
        means, variances = (np.stack([logs[part] for logs, _ in shown]) for part in (0, 1))
        weight = free.astype(np.float64)
        begin = _diagonal(wide)
        found = cls(begin, begin, darkness, darkness, UNKNOWN_SIGMA, UNKNOWN_SIGMA / float(darkness.mean()))
        near = np.ones_like(weight)
        levels, left = np.zeros((len(means), 3, 2)), means
        for _ in range(ROUNDS):
            levels = np.stack([found._levels(*one) for one in zip(left, weight, levels, strict=True)])
            left = np.where(free[..., None], means - np.stack([found._field(level) for level in levels]), 0.0)
            left = left.astype(np.float32)
            pooled = np.stack([_pooled(one, own) for one, own in zip(left, free, strict=True)])
            found = cls(
                _robust_covariance(left, weight, free, floor),
                _robust_covariance(pooled, near * free, free, floor),
                _typical(variances, free),
                darkness,
                max(GAIN_SIGMA, float(np.sqrt((levels[..., 0] ** 2).mean()))),
                max(FRAME_OFFSET_SIGMA, float(np.sqrt((levels[..., 1] ** 2).mean()))),
            )
            weight = np.asarray(free * (2.0 / (1.0 + _squared(left, found._inverse))), np.float64)
            near = np.asarray(2.0 / (1.0 + _squared(pooled, found._pooled_inverse)), np.float64)
        return found

    def evidence(self, image: NormalizedImage, squares: Float32Array | None = None) -> RestEvidence:
        """Return where an image shows skin at rest.

        squares : of an image that was reduced, means of the squared intensity of the pixels behind each of its own
        """
        size = self.covariance.shape[:2]
        logs, variance = _cell_logs(image, (size[0], size[1]), squares)
        weight, levels, left = np.ones(size, np.float32), np.zeros((3, 2)), logs
        for step in range(MAX_ROUNDS):
            before, levels = levels, self._levels(left, weight, levels)
            left = np.where(self._lit[..., None], logs - self._field(levels), np.float32(0.0))
            distance = np.asarray(cv2.GaussianBlur(_squared(left, self._inverse), (0, 0), 1.0), np.float32)
            wide = max(CAUCHY, float(np.median(distance[self._lit])) if step < WIDE_ROUNDS else 0.0)
            weight = 1.0 / (1.0 + np.square(distance / np.float32(wide)))
            if wide == CAUCHY and step and np.abs(levels - before).max() < SETTLED:
                break
        rough = cv2.GaussianBlur((variance / self.roughness).mean(axis=-1).astype(np.float32), (0, 0), 1.0)
        gentle = _squared(_pooled(left, np.ones(size, np.bool_)), self._pooled_inverse)
        kept = np.maximum(_shrink(np.maximum(distance, gentle), SHRINKAGE), _shrink(rough, ROUGHNESS_SHRINKAGE))
        calm = _hanging_together(np.where(self._lit, kept, np.float32(0.0)))
        light = self._light(levels, left, calm < RESTING) if self.removes_light else FrameLight.unchanged()
        return RestEvidence(calm, self._lit, light, self.gain_sigma)

    @property
    def noise(self) -> float:
        """Median over the field of the relative standard deviation of a cell's light, mean over channels."""
        variance = np.einsum("...ii->...", self.covariance) / 3.0
        return float(np.sqrt(np.median(variance)))

    @cached_property
    def _mean_darkness(self) -> Float32Array:
        """Mean of `darkness` over the lit field, shape (3,)."""
        lit = self._lit[..., None]
        mean = (self.darkness * lit).sum(axis=(0, 1)) / max(np.count_nonzero(lit), 1)
        return np.asarray(mean, np.float32)

    @cached_property
    def _lit(self) -> MaskArray:
        """True for cells whose reference is bright enough to divide by."""
        return np.asarray((self.darkness < LIT / DARK_FLOOR).all(axis=-1), np.bool_)

    @cached_property
    def _inverse(self) -> Float32Array:
        return _inverse_in_planes(self.covariance)

    @cached_property
    def _pooled_inverse(self) -> Float32Array:
        return _inverse_in_planes(self.pooled)

    @cached_property
    def _contrast(self) -> Float32Array:
        """Darkness of cells less its mean, shape (3, cells)."""
        return np.ascontiguousarray((self.darkness - self._mean_darkness).reshape(-1, 3).T, np.float32)

    @cached_property
    def _precision(self) -> Float32Array:
        """Information of a cell on a level, zero where it is not lit: shape (3, cells)."""
        variance = CELLS_ALIKE * np.einsum("...ii->i...", self.covariance)
        return np.ascontiguousarray(self._lit.ravel() / variance.reshape(3, -1), np.float32)

    def _levels(self, residual: Float32Array, weight: NDArray[Any], start: Float64Array) -> Float64Array:
        """Return levels (3, 2) of cells' log intensity by one Gauss-Newton step from others.

        A level is the logarithm of a channel's light where its reference has its mean darkness, and the offset over
        that light. The residual (h, w, 3) is what the others leave of the log intensity.
        """
        light = self._offset_light(start)
        left = np.ascontiguousarray(residual.reshape(-1, 3).T)
        answer, weighted = self._contrast / light, self._precision * weight.ravel()
        moved = weighted * answer
        sigma = np.array([self.gain_sigma, self.offset_sigma])
        prior = 1.0 / (sigma**2 + np.square(start / OUTLYING))
        one, once = weighted.sum(axis=1) + prior[:, 0], moved.sum(axis=1)
        twice, level, slope = (
            np.einsum("ij,ij->i", *two) for two in ((moved, answer), (weighted, left), (moved, left))
        )
        twice += prior[:, 1]
        level, slope = level - prior[:, 0] * start[:, 0], slope - prior[:, 1] * start[:, 1]
        steps = np.stack([twice * level - once * slope, one * slope - once * level], axis=-1)
        return np.asarray(start + steps / (one * twice - once**2)[:, None])

    def _field(self, levels: Float64Array) -> Float32Array:
        """Return the log intensity (h, w, 3) of untouched skin under levels (3, 2)."""
        log_light = levels[:, :1].astype(np.float32) + np.log(self._offset_light(levels))
        return np.asarray(log_light.T.reshape(self.darkness.shape), np.float32)

    def _offset_light(self, levels: Float64Array) -> Float32Array:
        """Return the light of untouched skin (3, cells) under offsets, over that of mean darkness."""
        light = np.float32(1.0) + levels[:, 1:].astype(np.float32) * self._contrast
        return np.asarray(np.maximum(light, np.float32(LEAST_LIGHT)), np.float32)

    def _light(self, levels: Float64Array, left: Float32Array, resting: MaskArray) -> FrameLight:
        """Return the light of a frame with these levels (3, 2), as far as they exceed their uncertainty.

        left, resting : see `certain_levels`
        """
        gain, offset = certain_levels(levels, left, resting, self.darkness)
        light = np.exp(gain)
        return FrameLight(light * np.maximum(1.0 - offset * self._mean_darkness, LEAST_LIGHT), light * offset)


def _cells(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return rows and columns of cells of a field of `shape` (H, W)."""
    across = min(CELLS_ACROSS, shape[1] // 2)
    return max(round(shape[0] * across / shape[1]), 1), across


def _reduced(values: NDArray[Any], size: tuple[int, int]) -> Float32Array:
    planes = np.moveaxis(values, -1, 0)
    if planes.flags.c_contiguous:  # OpenCV would copy it
        small = [cv2.resize(plane, size[::-1], interpolation=cv2.INTER_AREA) for plane in planes]
        return np.asarray(np.stack(small, axis=-1), np.float32)
    return np.asarray(cv2.resize(values, size[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _cell_logs(
    image: NormalizedImage, size: tuple[int, int], squares: Float32Array | None = None
) -> tuple[Float32Array, Float32Array]:
    """Return the log of the mean intensity of cells, and relative variance within them: float32 arrays (h, w, 3).

    squares : as of `SkinAtRest.evidence`
    """
    values = np.nan_to_num(image.values, nan=1.0)
    mean = np.maximum(_reduced(values, size), np.float32(MIN_LIGHT))
    variance = np.maximum(_reduced(values * values if squares is None else squares, size) / mean**2 - 1.0, 1e-8)
    return np.log(mean), np.asarray(variance, np.float32)


def _far_from(balls: Sequence[Ball], shape: tuple[int, int], size: tuple[int, int]) -> MaskArray:
    """Return True for cells farther than `FREE_RADII` from every ball: bool array of shape (h, w)."""
    row, column = ((np.arange(count) + 0.5) * length / count - 0.5 for count, length in zip(size, shape, strict=True))
    far = np.ones(size, np.bool_)
    for ball in balls:
        reach = FREE_RADII * ball.contact_radius_px
        far &= np.hypot(row[:, None] - ball.row, column[None, :] - ball.column) > reach
    return far


def _pooled(left: Float32Array, free: MaskArray) -> Float32Array:
    """Return the mean of free cells (h, w, 3) over their neighbourhood."""
    share = np.maximum(cv2.GaussianBlur(free.astype(np.float32), (0, 0), POOLED_CELLS), np.float32(0.05))
    known = np.ascontiguousarray(left * free[..., None], np.float32)
    return np.asarray(cv2.GaussianBlur(known, (0, 0), POOLED_CELLS) / share[..., None], np.float32)


def _inverse_in_planes(covariance: Float32Array) -> Float32Array:
    """Return the inverse of matrices (h, w, 3, 3), each of their components contiguous in memory."""
    components = np.moveaxis(np.linalg.inv(covariance.astype(np.float64)), (-2, -1), (0, 1))
    return np.moveaxis(np.ascontiguousarray(components, np.float32), (0, 1), (-2, -1))


def _squared(left: Float32Array, precision: Float32Array) -> Float32Array:
    """Return the squared Mahalanobis distance a channel of values (..., h, w, 3) by the inverse of their covariance."""
    one, two, three = np.moveaxis(left, -1, 0)
    by_one, by_two, by_three = np.moveaxis(precision, (-2, -1), (0, 1))
    total = one * (by_one[0] * one + np.float32(2.0) * (by_one[1] * two + by_one[2] * three))
    total += two * (by_two[1] * two + np.float32(2.0) * by_two[2] * three) + by_three[2] * (three * three)
    return np.asarray(total / np.float32(3.0), np.float32)


def _shrink(square: Float32Array, threshold: float) -> Float32Array:
    """Positive part of 1 - threshold / square."""
    return np.asarray(np.maximum(1.0 - threshold / np.maximum(square, 1e-6), 0.0), np.float32)


def _diagonal(variance: Float64Array) -> Float32Array:
    return np.asarray(variance[..., None] * np.eye(3), np.float32)


def _smoothed(values: Float64Array) -> Float64Array:
    """Return the mean over a neighbourhood of cells of an array (h, w, ...)."""
    flat = values.reshape(*values.shape[:2], -1)
    sigma = flat.shape[1] / 16.0
    smooth = [cv2.GaussianBlur(np.ascontiguousarray(flat[..., part]), (0, 0), sigma) for part in range(flat.shape[-1])]
    return np.asarray(np.stack(smooth, axis=-1).reshape(values.shape), np.float64)


def _robust_covariance(left: Float32Array, weight: Float64Array, free: MaskArray, floor: Float64Array) -> Float32Array:
    """Return the covariance (h, w, 3, 3) of the presses' noise, smooth over the field.

    left : what gains and offsets leave of N presses, shape (N, h, w, 3)
    weight : of the presses' cells, shape (N, h, w)
    floor : least variance, shape (h, w, 3)
    """
    clipped = np.clip(left.astype(np.float64), -0.3, 0.3)
    outer = clipped[..., :, None] * clipped[..., None, :]
    count = _smoothed(free.sum(axis=0).astype(np.float64))
    total = _smoothed((outer * weight[..., None, None]).sum(axis=0))
    known = count > 0.1
    covariance = np.where(known[..., None, None], total / np.maximum(count, 0.1)[..., None, None], 0.0)
    missing = np.where(known[..., None], 0.0, UNKNOWN_SIGMA**2)
    return np.asarray(covariance + (floor + missing)[..., None] * np.eye(3), np.float32)


def _typical(variances: Float32Array, free: MaskArray) -> Float32Array:
    """Return the median variance of each cell where it is free, shape (h, w, 3), else of all free cells."""
    shown = np.where(free[..., None], variances, np.nan)
    everywhere = np.nanmedian(shown.reshape(-1, 3), axis=0)
    seen = free.sum(axis=0) >= MIN_PRESSES
    typical = np.broadcast_to(everywhere, variances.shape[1:]).copy()
    typical[seen] = np.nanmedian(shown[:, seen], axis=0)
    return np.asarray(np.maximum(typical, 1e-7), np.float32)


def _hanging_together(kept: Float32Array) -> Float32Array:
    """Return `kept`, 1 where calm cells neither reach the border nor are many: a ball's top has no slope either."""
    calm = large_parts(kept < CALM, 0.01, 0.03, connectivity=4)
    near = cv2.dilate(calm.astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.where(near > 0, kept, np.float32(1.0))
