"""Skin as makers of gel sensors describe it: intensity a quadratic function of the normal, coefficients linear in
position; and balls pressed into it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from device.balls.sphere import Ball, sphere_slopes
from device.imaging.flat_field import NormalizedImage

SHAPE = (240, 320)
RADIUS_PX = 60.0
CONTACT_PX = 30.0
DIRECTIONS = np.radians([90.0, 210.0, 330.0])


def light_of(p: np.ndarray, q: np.ndarray, column: np.ndarray, row: np.ndarray, colours: float = 0.0) -> np.ndarray:
    """Light (..., 3) of slopes at pixels; `colours` is by how much untouched skin changes over the field."""
    up = 1.0 / np.sqrt(1.0 + p * p + q * q)
    x, y = -p * up, -q * up
    across, down = 2.0 * column / SHAPE[1] - 1.0, 2.0 * row / SHAPE[0] - 1.0
    planes = []
    for angle in DIRECTIONS:
        towards = np.cos(angle) * x + np.sin(angle) * y
        near = np.cos(angle) * across + np.sin(angle) * down
        own = (
            0.5 * (1.0 + colours * near)
            + (0.5 + 0.1 * near) * towards
            + 0.35 * up
            + 0.12 * towards * towards
            + 0.05 * x * y
        )
        planes.append(own)
    return np.stack(planes, axis=-1)


def shown(p: np.ndarray, q: np.ndarray, column: np.ndarray, row: np.ndarray, colours: float = 0.0) -> np.ndarray:
    """The same over that of untouched skin."""
    level = np.zeros_like(p)
    return light_of(p, q, column, row, colours) / light_of(level, level, column, row, colours)


def presses(noise: float = 0.003, colours: float = 0.0) -> Iterator[tuple[NormalizedImage, list[Ball]]]:
    """Twelve balls, each pressed alone."""
    random = np.random.default_rng(3)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    everywhere = np.ones(SHAPE, np.bool_)
    for number in range(12):
        ball = Ball(50.0 + 73.0 * (number % 4), 45.0 + 75.0 * (number // 4), CONTACT_PX, RADIUS_PX)
        inside = np.hypot(column - ball.column, row - ball.row) < ball.contact_radius_px
        p, q = (
            np.where(inside, slope, 0.0).astype(np.float64)
            for slope in sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32))
        )
        values = shown(p, q, column, row, colours) + noise * random.standard_normal((*SHAPE, 3))
        yield NormalizedImage(values.astype(np.float32), everywhere, ~everywhere), [ball]
