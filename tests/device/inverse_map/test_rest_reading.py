"""Untouched skin has no slope: what curves and noise make of it is taken off."""

from dataclasses import replace

import numpy as np
import pytest

from device.balls.sphere import Ball, gather_samples, sphere_slopes
from device.calibration.fit import fit_inverse_map
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.branches import Part, light_at_rest
from device.inverse_map.model import InverseMap
from device.inverse_map.near_light import IlluminationMap
from device.inverse_map.noise_bias import measure_noise_bias
from device.inverse_map.regressor import FeatureRegressor, FeatureScaler
from device.inverse_map.tabulated import TabulatedInverseMap
from device.inverse_map.training_domain import TrainingDomain

SHAPE = (180, 240)


def lambertian(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Intensity under three lights whose elevations differ."""
    angle, rise = np.radians([90.0, 210.0, 330.0]), np.array([0.5, 0.8, 0.6])
    facing = rise - p[..., None] * np.cos(angle) - q[..., None] * np.sin(angle)
    shade = np.maximum(facing, 0.0) / rise / np.sqrt(1.0 + p**2 + q**2)[..., None]
    return np.asarray(shade, np.float32)


def untouched(noise: float, seed: int) -> NormalizedImage:
    values = 1.0 + noise * np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def press(ball: Ball, seed: int) -> NormalizedImage:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    inside = np.hypot(column - ball.column, row - ball.row) <= ball.contact_radius_px
    p, q = (np.where(inside, slope, 0.0) for slope in sphere_slopes(ball, column, row))
    noise = 0.01 * np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    values = (lambertian(p, q) + noise).astype(np.float32)
    return NormalizedImage(values, np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


@pytest.fixture(scope="module")
def fitted() -> InverseMap:
    balls = [Ball(column, row, 22.0, 40.0) for row in (40.0, 130.0) for column in (50.0, 120.0, 190.0)]
    samples = gather_samples((press(ball, seed), [ball]) for seed, ball in enumerate(balls))
    return fit_inverse_map(samples, balls, SHAPE, max_samples=6_000).map


def test_the_fitted_map_reads_no_slope_on_untouched_skin(fitted: InverseMap) -> None:
    slopes = fitted.on_grid(np.ones((*SHAPE, 3), np.float32), np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    assert np.abs(slopes).max() < 1e-5


def test_the_quick_look_reads_none_either(fitted: InverseMap) -> None:
    found = TabulatedInverseMap.of(fitted, 2).gradients(
        NormalizedImage(
            np.ones((SHAPE[0] // 2, SHAPE[1] // 2, 3), np.float32),
            np.ones((SHAPE[0] // 2, SHAPE[1] // 2), bool),
            np.zeros((SHAPE[0] // 2, SHAPE[1] // 2), bool),
        )
    )
    assert max(np.abs(found.p).max(), np.abs(found.q).max()) < 2e-4


def test_balls_are_read_as_before(fitted: InverseMap) -> None:
    ball = Ball(100.0, 80.0, 22.0, 40.0)
    samples = gather_samples([(press(ball, 99), [ball])])
    read = fitted.predict(samples.intensity, samples.column, samples.row)
    error = read - np.stack([samples.p, samples.q], axis=-1)
    assert np.abs(error.mean(axis=0)).max() < 0.01


def test_a_curve_of_light_reads_nothing_where_its_light_is_that_of_untouched_skin() -> None:
    across, down = np.meshgrid(np.linspace(-1.0, 1.0, 31), np.linspace(-1.0, 1.0, 23))
    field = IlluminationMap(
        np.stack([1.0 + 0.3 * across, 1.0 - 0.2 * down, 1.0 + 0.1 * across * down], -1).astype(np.float32)
    )
    space = FeatureScaler(*(np.full(3, v, np.float32) for v in (1.0, 0.3, 0.1, 2.0)), linear=True)
    coefficients = np.random.default_rng(0).normal(0.0, 0.1, (10, 6, 2)).astype(np.float32)
    curve = FeatureRegressor(space, 2, 2, coefficients)
    light = Part(field, curve, 0.5, light_at_rest(curve, field))
    place = np.random.default_rng(1).uniform(-1.0, 1.0, (500, 2))
    assert np.abs(curve.at(field.at(place), place)).max() > 0.1
    assert np.abs(light.u_at(np.ones((500, 3), np.float32), place)).max() < 2e-3


def bending(strength: float) -> InverseMap:
    """A map whose u across is `strength` times the square of (R - 1), and that reads nothing else."""
    low, high = np.log([0.05, 5.0]).astype(np.float32)
    space = FeatureScaler(np.zeros(3, np.float32), np.ones(3, np.float32), np.full(3, low), np.full(3, high))
    coefficients = np.zeros((10, 1, 2), np.float32)
    # log(1.05 + n) = log 1.05 + n / 1.05 - ...: its square about the centre is (n / 1.05)² to third order.
    space = replace(space, centre=np.full(3, np.log(1.05), np.float32))
    coefficients[9, 0, 0] = strength * 1.05**2
    return InverseMap(
        SHAPE, TrainingDomain.observed(np.ones((4, 3), np.float32)), FeatureRegressor(space, 2, 0, coefficients), 1.0
    )


def test_noise_adds_what_the_curvature_says_times_its_variance() -> None:
    """E[k n²] = k σ²; the mean of 120,000 pixels knows it to some percent in every cell."""
    frames = [untouched(0.02, seed) for seed in range(3)]
    bias = measure_noise_bias(bending(3.0), frames)
    assert np.median(bias[..., 0]) == pytest.approx(3.0 * 0.02**2, rel=0.05)
    assert np.abs(bias[..., 1]).max() == 0.0


def test_untouched_skin_with_noise_reads_flat_once_its_noise_is_known() -> None:
    curved = bending(3.0)
    known = replace(curved, noise_bias=measure_noise_bias(curved, [untouched(0.02, seed) for seed in range(3)]))
    raw, flat = (found.gradients(untouched(0.02, 9)).p.mean() for found in (curved, known))
    assert raw > 1e-3
    assert abs(flat) < 0.05 * raw


def test_a_file_of_before_is_read_as_it_was(fitted: InverseMap) -> None:
    arrays = replace(fitted, noise_bias=np.full((3, 4, 2), 0.01, np.float32)).arrays()
    assert InverseMap.from_arrays(arrays, "new").noise_bias is not None
    del arrays["noise_bias"]
    assert InverseMap.from_arrays(arrays, "old").noise_bias is None
