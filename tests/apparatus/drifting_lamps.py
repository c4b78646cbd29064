"""Frames of untouched skin and a dome under lamps that drifted, in the light of the surroundings."""

from __future__ import annotations

import numpy as np

from device.balls.sphere import Ball, sphere_slopes
from device.imaging.flat_field import NormalizedImage

SHAPE = (240, 320)
ROW, COLUMN = (axis.astype(float) for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
ANSWER = np.array([[1.0, -0.5, -0.5], [0.0, 0.8, -0.8]])
"""Change of the three channels' log light with slopes p and q."""

NOISE = 0.005
DRIFT = np.array([-0.02, 0.0, 0.01])
LIGHT = 0.15 + 0.6 * np.exp(-(((COLUMN[..., None] - np.array([0.0, 160.0, 320.0])) / 150.0) ** 2))
"""Light of untouched skin, fraction of full scale."""

BALLS = tuple(Ball(column, row, 30.0, 50.0) for row in (60.0, 180.0) for column in (60.0, 160.0, 260.0))
NONE = np.zeros(3)


def press(ball: Ball, drift: np.ndarray = NONE, seed: int = 0) -> NormalizedImage:
    """Return what a ball shows under lamps that drifted."""
    inside = np.hypot(COLUMN - ball.column, ROW - ball.row) <= ball.contact_radius_px
    slopes = np.stack(sphere_slopes(ball, COLUMN.astype(np.float32), ROW.astype(np.float32)), axis=-1)
    return _lit(np.where(inside[..., None], slopes, 0.0), drift, NONE, seed)


def frame(
    drift: np.ndarray = NONE, seed: int = 0, *, stray: np.ndarray = NONE, dome: float = 1.0, clipped: bool = False
) -> NormalizedImage:
    """Return a dome of 40 px on untouched skin; without height where `dome` is 0."""
    across, down = COLUMN - 160.0, ROW - 120.0
    fall = dome * np.exp(-(across**2 + down**2) / (2.0 * 20.0**2)) / 20.0
    return _lit(np.stack([-across * fall, -down * fall], axis=-1), drift, stray, seed, clipped=clipped)


def relief(slope: float, *, radius_px: float = 130.0, bounce: float = 0.01, seed: int = 0) -> NormalizedImage:
    """Return a disk with waves as steep as `slope` that covers most of the field, and darkens the skin around it.

    bounce : fraction of the light that the skin at the disk's edge lacks
    """
    across, down = COLUMN - 160.0, ROW - 120.0
    radius = np.maximum(np.hypot(across, down), 1.0)
    waves = np.stack([np.sin(COLUMN / 40.0), np.cos(ROW / 30.0)], axis=-1)
    flank = -0.3 * np.stack([across, down], axis=-1) / radius[..., None]
    slopes = np.where((radius < radius_px)[..., None], slope * waves, 0.0)
    image = _lit(slopes + np.where((np.abs(radius - radius_px) < 8.0)[..., None], flank, 0.0), NONE, NONE, seed)
    lacking = np.where(radius < radius_px, 0.0, bounce * np.exp(-(radius - radius_px) / 40.0))
    image.values[:] *= (1.0 - lacking).astype(np.float32)[..., None]
    return image


def _lit(
    slopes: np.ndarray, drift: np.ndarray, stray: np.ndarray, seed: int, *, clipped: bool = False
) -> NormalizedImage:
    noise = NOISE * np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    values = np.exp(slopes @ ANSWER + drift + noise) + stray / LIGHT
    everywhere = np.ones(SHAPE, np.bool_)
    return NormalizedImage(values.astype(np.float32), everywhere, everywhere & clipped)
