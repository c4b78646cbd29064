"""Intensity of a matt skin under three near lights is read as the slopes that made it."""

import numpy as np
import pytest

from device.balls.sphere import BallSamples
from device.inverse_map.near_light import GENTLE, MIN_BRIGHTNESS, NearLightModel
from device.inverse_map.regressor import field_position

SHAPE = (120, 160)
LIGHTS = 2.5 * np.array([[np.cos(a), np.sin(a), 0.6] for a in np.radians([90.0, 210.0, 330.0])])
"""Points over a field that reaches from -1 to 1."""


def shaded(slope: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Light of a matt skin over that of a flat one, each channel from a point of its own: (N, 3)."""
    towards = LIGHTS[None, :, :2] - place[:, None, :]
    facing = LIGHTS[None, :, 2] - np.einsum("ni,nki->nk", slope, towards)
    return facing / LIGHTS[None, :, 2] / np.sqrt(1.0 + (slope**2).sum(axis=1))[:, None]


def scattered(count: int, most: float, seed: int) -> tuple[BallSamples, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    slope = random.uniform(-most, most, (count, 2))
    column, row = (random.uniform(0.0, size - 1.0, count).astype(np.float32) for size in (SHAPE[1], SHAPE[0]))
    place = field_position(column, row, SHAPE).astype(np.float64)
    intensity = shaded(slope, place).astype(np.float32)
    samples = BallSamples(intensity, slope[:, 0], slope[:, 1], column, row, np.zeros(count, np.intp))
    return samples, slope, place


def test_slopes_and_brightness_of_a_matt_skin_come_back_wherever_it_lies() -> None:
    samples, slope, _ = scattered(4000, 0.5, 0)
    near = NearLightModel.of(samples, slope, SHAPE)
    others, truth, place = scattered(500, 0.3, 1)
    seen = near.seen(others.intensity, place)
    np.testing.assert_allclose(seen[:, :2], truth, atol=2e-3)
    np.testing.assert_allclose(seen[:, 2], 1.0 / np.sqrt(1.0 + (truth**2).sum(axis=1)), atol=2e-3)


def test_only_gentle_slopes_show_where_the_lights_are() -> None:
    samples, slope, _ = scattered(4000, 0.9, 0)
    dark = np.linalg.norm(slope, axis=1) > GENTLE
    samples.intensity[dark] = 0.0
    expected = NearLightModel.of(*scattered(4000, 0.2, 2)[:2], SHAPE)
    np.testing.assert_allclose(NearLightModel.of(samples, slope, SHAPE).directions, expected.directions, atol=5e-3)


def test_slopes_none_of_which_is_gentle_show_no_light() -> None:
    samples, slope, _ = scattered(500, 0.9, 0)
    near = NearLightModel.of(samples, np.sign(slope) * (np.abs(slope) + GENTLE), SHAPE)
    np.testing.assert_array_equal(near.directions, 0.0)


def test_rows_are_read_as_single_pixels_are() -> None:
    samples, slope, _ = scattered(2000, 0.5, 0)
    near = NearLightModel.of(samples, slope, SHAPE)
    across, down = np.linspace(-0.9, 0.9, 7, dtype=np.float32), np.linspace(-0.5, 0.5, 4, dtype=np.float32)
    values = np.random.default_rng(3).uniform(0.2, 1.5, (4, 7, 3)).astype(np.float32)
    place = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2).astype(np.float64)
    np.testing.assert_array_equal(
        near.seen_rows(values, across, down), near.seen(values.reshape(-1, 3), place).reshape(4, 7, 3)
    )


def test_darkness_and_lights_in_one_plane_still_give_numbers() -> None:
    near = NearLightModel(np.zeros((6, 2, 3), np.float32))
    seen = near.seen(np.zeros((2, 3), np.float32), np.zeros((2, 2)))
    np.testing.assert_allclose(seen, [[0.0, 0.0, 1.0]] * 2)
    samples, slope, _ = scattered(2000, 0.5, 0)
    dark = NearLightModel.of(samples, slope, SHAPE).seen(np.zeros((2, 3), np.float32), np.zeros((2, 2)))
    assert np.isfinite(dark).all()
    np.testing.assert_allclose(dark[:, 2], MIN_BRIGHTNESS)


@pytest.mark.parametrize("swapped", [False, True])
def test_directions_that_fall_into_one_plane_beyond_the_balls_do_not_amplify_noise(swapped: bool) -> None:
    directions = np.zeros((10, 2, 3), np.float32)
    directions[0] = [[1.0, -0.5, -0.5], [0.0, 0.9, -0.9]]
    directions[1, 1, 1:] = -0.9, 0.9  # by x: the volume is 0 at the field's right border and changes its sign there
    near = NearLightModel(directions[..., ::-1].copy() if swapped else directions)
    assert (near.min_volume < 0.0) == swapped
    noise = 0.01 * np.random.default_rng(0).standard_normal((1000, 3)).astype(np.float32)
    for x in (0.99, 1.0, 1.01):
        seen = near.seen(1.0 + noise, np.tile((x, 0.0), (1000, 1)))
        assert np.abs(seen[:, :2]).max() < 0.3
        np.testing.assert_allclose(seen[:, 2], 1.0, atol=0.1)
        np.testing.assert_allclose(
            near.seen(np.ones((1, 3), np.float32), np.array([[x, 0.0]])), [[0.0, 0.0, 1.0]], atol=1e-6
        )


def test_a_file_returns_it_and_one_that_holds_none_says_so() -> None:
    samples, slope, _ = scattered(2000, 0.5, 0)
    near = NearLightModel.of(samples, slope, SHAPE)
    np.testing.assert_array_equal(NearLightModel.from_arrays(near.arrays()).directions, near.directions)
    with pytest.raises(ValueError, match="lights of shape"):
        NearLightModel.from_arrays({"directions": np.zeros((3, 2))})
