"""Slopes that no ball taught are marked: steeper ones, and colours of high leverage."""

import numpy as np
import pytest

from device.balls.sphere import Ball, gather_samples, sphere_slopes
from device.calibration.fit import fit_inverse_map
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from host_sync.gradients.confidence import extrapolated, out_of_domain_blocks

SHAPE = (240, 320)
STEEPEST = 0.5


def shaded(p: np.ndarray, q: np.ndarray) -> NormalizedImage:
    """Diffuse skin under three lights at 45 degrees, with a little noise."""
    channels = []
    for angle in np.radians([90.0, 210.0, 330.0]):
        shade = (1.0 - p * np.cos(angle) - q * np.sin(angle)) / np.sqrt(1.0 + p**2 + q**2)
        channels.append(np.maximum(shade, 0.0))
    values = np.stack(channels, axis=-1)
    values += 0.01 * np.random.default_rng(0).standard_normal(values.shape)
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def cap(ball: Ball) -> tuple[np.ndarray, np.ndarray]:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 <= ball.contact_radius_px**2
    p, q = sphere_slopes(ball, column, row)
    return np.where(inside, p, 0.0), np.where(inside, q, 0.0)


def ball_at(column: float, row: float, steepest: float = STEEPEST) -> Ball:
    radius = 60.0
    return Ball(column, row, radius * steepest / np.hypot(1.0, steepest), radius)


@pytest.fixture(scope="module")
def taught() -> InverseMap:
    balls = [ball_at(column, row) for row in (60.0, 120.0, 180.0) for column in (60.0, 125.0, 190.0, 255.0)]
    presses = [(shaded(*cap(ball)), [ball]) for ball in balls]
    return fit_inverse_map(gather_samples(presses), balls, SHAPE, max_samples=12_000).map


def test_what_a_ball_taught_is_not_marked(taught: InverseMap) -> None:
    p, q = cap(ball_at(150.0, 100.0, 0.95 * STEEPEST))
    assert extrapolated(shaded(p, q), taught, p, q).mean() < 0.002


def test_steeper_slopes_are_marked(taught: InverseMap) -> None:
    ball = ball_at(150.0, 100.0, 2.0 * STEEPEST)
    p, q = cap(ball)
    found = extrapolated(shaded(p, q), taught, p, q)
    steep = np.hypot(p, q) > 1.1 * STEEPEST
    assert found[steep].all()
    assert found[np.hypot(p, q) < 0.8 * STEEPEST].mean() < 0.05


def test_colours_of_no_ball_are_marked_though_they_read_flat(taught: InverseMap) -> None:
    flat = np.zeros(SHAPE)
    image = shaded(flat, flat)
    image.values[40:120, 40:120] = (0.3, 0.3, 0.3)
    found = extrapolated(image, taught, flat, flat)
    assert found[50:110, 50:110].all()
    np.testing.assert_array_equal(extrapolated(image, taught, flat, flat, out_of_domain_blocks(image, taught)), found)
    assert not found[140:, 140:].any()


def test_invalid_pixels_are_not_extrapolated(taught: InverseMap) -> None:
    p = np.full(SHAPE, np.nan)
    assert not extrapolated(shaded(np.zeros(SHAPE), np.zeros(SHAPE)), taught, p, p).any()
