"""Intensity of balls without noise: it keeps what the ball shows, and a map taught with it does not read too flat."""

from dataclasses import replace

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples, gather_samples, pixels_inside, quiet_intensity, sphere_slopes
from device.calibration.fit import fit_inverse_map
from device.imaging.flat_field import NormalizedImage

SHAPE = (240, 320)
RADIUS_PX, CONTACT_PX = 50.0, 32.0
NOISE = 0.08
BALLS = [
    Ball(column, row, CONTACT_PX, RADIUS_PX) for row in (45.0, 120.0, 195.0) for column in (50.0, 125.0, 200.0, 270.0)
]
LIGHTS = np.stack([np.cos(np.radians([90.0, 210.0, 330.0])), np.sin(np.radians([90.0, 210.0, 330.0]))])


def shaded(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Intensity of a matt skin under three far lights at 45 degrees."""
    return (1.0 - np.stack([p, q], axis=-1) @ LIGHTS) / np.sqrt(1.0 + p**2 + q**2)[..., None]


def press(ball: Ball, seed: int) -> NormalizedImage:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 < ball.contact_radius_px**2
    p, q = (np.where(inside, slope, 0.0) for slope in sphere_slopes(ball, column, row))
    values = np.maximum(shaded(p, q), 0.0) + NOISE * np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


@pytest.fixture(scope="module")
def samples() -> BallSamples:
    return gather_samples([(press(ball, seed), [ball]) for seed, ball in enumerate(BALLS)], for_fit=True)


def test_noise_is_averaged_and_the_ball_is_kept(samples: BallSamples) -> None:
    truth = np.maximum(shaded(samples.p, samples.q), 0.0)
    assert samples.quiet is not None
    off = samples.quiet - truth
    assert off.std() < 0.35 * NOISE
    assert np.abs(off.mean(axis=0)).max() < 0.05 * NOISE
    rim = np.hypot(samples.p, samples.q) > 0.95 * BALLS[0].steepest
    assert np.abs(off[rim].mean(axis=0)).max() < 0.1 * NOISE


def test_dust_stays_where_it_is() -> None:
    image = press(BALLS[5], 0)
    row, column = pixels_inside(BALLS[5], SHAPE)
    clean = quiet_intensity(image.values[row, column], row, column, CONTACT_PX)
    dust = np.hypot(row - BALLS[5].row - 8.0, column - BALLS[5].column + 6.0)
    dusty = np.where(dust[:, None] < 4.0, np.float32(0.1), image.values[row, column])
    found = quiet_intensity(dusty, row, column, CONTACT_PX)
    assert np.abs(found - clean)[dust > 8.0].max() < 0.25 * NOISE


def test_few_pixels_keep_their_noise() -> None:
    ball = Ball(5.0, 5.0, 4.0, 20.0)
    row, column = pixels_inside(ball, (11, 11))
    seen = np.random.default_rng(0).random((len(row), 3)).astype(np.float32)
    np.testing.assert_array_equal(quiet_intensity(seen, row, column, ball.contact_radius_px), seen)


def gain(taught: BallSamples) -> float:
    """Of a ball of gentle slopes that is read with noise, on the true slope."""
    found = fit_inverse_map(taught, BALLS, SHAPE, max_samples=12_000).map
    ball = Ball(160.0, 100.0, 50.0, 250.0)
    row, column = pixels_inside(ball, SHAPE)
    read = found.predict(press(ball, 99).values[row, column], column.astype(np.float32), row.astype(np.float32))
    truth = np.stack(sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32)), axis=-1)
    return float((read * truth).sum() / (truth**2).sum())


def test_a_map_taught_with_noise_reads_flatter_than_one_taught_without(samples: BallSamples) -> None:
    assert gain(replace(samples, quiet=None)) < 0.985
    assert gain(samples) == pytest.approx(1.0, abs=0.008)
