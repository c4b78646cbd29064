"""Frames of untouched skin and a dome under lamps that drifted, and a map that reads them as they were drawn."""

from __future__ import annotations

import numpy as np

from device.balls.sphere import Ball, gather_samples, sphere_slopes
from device.calibration.fit import fit_inverse_map
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap

SHAPE = (240, 320)
ROW, COLUMN = (axis.astype(float) for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
ANSWER = np.array([[1.0, -0.5, -0.5], [0.0, 0.8, -0.8]])
"""Change of the three channels' log light with slopes p and q."""

NOISE = 0.005
DRIFT = np.array([-0.02, 0.0, 0.01])


def _press(ball: Ball, seed: int) -> NormalizedImage:
    """What a ball shows, without drift."""
    inside = np.hypot(COLUMN - ball.column, ROW - ball.row) <= ball.contact_radius_px
    slopes = np.stack(sphere_slopes(ball, COLUMN.astype(np.float32), ROW.astype(np.float32)), axis=-1)
    noise = NOISE * np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    values = np.exp(np.where(inside[..., None], slopes, 0.0) @ ANSWER + noise).astype(np.float32)
    return NormalizedImage(values, np.ones(SHAPE, np.bool_), np.zeros(SHAPE, np.bool_))


def _fitted() -> InverseMap:
    balls = [Ball(column, row, 30.0, 50.0) for row in (60.0, 180.0) for column in (60.0, 160.0, 260.0)]
    samples = gather_samples((_press(ball, 900 + seed), [ball]) for seed, ball in enumerate(balls))
    return fit_inverse_map(samples, balls, SHAPE, max_samples=6_000).map


MAP = _fitted()
"""Fitted to balls whose channels answer as `ANSWER` has it."""


def frame(drift: np.ndarray, seed: int = 0, *, dome: float = 1.0, clipped: bool = False) -> NormalizedImage:
    """A dome of 40 px on untouched skin under lamps that drifted; without height where `dome` is 0."""
    across, down = COLUMN - 160.0, ROW - 120.0
    fall = dome * np.exp(-(across**2 + down**2) / (2.0 * 20.0**2)) / 20.0
    slopes = np.stack([-across * fall, -down * fall], axis=-1)
    noise = NOISE * np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    values = np.exp(slopes @ ANSWER + drift + noise).astype(np.float32)
    everywhere = np.ones(SHAPE, np.bool_)
    return NormalizedImage(values, everywhere, everywhere & clipped)
