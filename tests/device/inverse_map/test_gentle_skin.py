"""What balls show of gentle slopes predicts gentle slopes anywhere else in the field."""

import numpy as np
import pytest

from device.balls.sphere import BallSamples
from device.inverse_map.gentle_skin import GentleSkin
from device.inverse_map.near_light import IlluminationMap
from device.inverse_map.regressor import field_position

SHAPE = (120, 160)
BALLS = 12
NODES = np.stack(np.meshgrid(*(np.linspace(-1.0, 1.0, count) for count in (21, 16))), axis=-1)
"""Positions of the places at which a reference's light is kept."""


def towards(place: np.ndarray) -> np.ndarray:
    """Where three lights stand as seen from places (N, 2): (N, 2, 3)."""
    angle = np.radians([90.0, 210.0, 330.0])
    far = np.stack([np.cos(angle), np.sin(angle)])
    return 0.8 * far[None] - 0.3 * place[:, :, None]


def shaded(slope: np.ndarray, place: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Intensity (N, 3) of a coat whose contrast grows with slope, more to one side of the field.

    light : (N, 3), what the lights' directions are divided by
    """
    lit = np.einsum("ni,nik->nk", slope, towards(place)) / light
    growth = 1.0 + (0.5 + 0.4 * place[:, :1]) * (slope**2).sum(axis=1, keepdims=True)
    return (1.0 + growth * lit) / np.sqrt(1.0 + (slope**2).sum(axis=1, keepdims=True))


def on_balls(light: IlluminationMap | None = None) -> tuple[BallSamples, np.ndarray]:
    random = np.random.default_rng(0)
    centres = np.stack(np.meshgrid([20.0, 60.0, 100.0, 140.0], [20.0, 60.0, 100.0]), axis=-1).reshape(-1, 2)
    ball = np.repeat(np.arange(BALLS), 400)
    slope = random.uniform(-0.5, 0.5, (len(ball), 2))
    column, row = (centres[ball] + 25.0 * slope).T.astype(np.float32)
    place = field_position(column, row, SHAPE).astype(np.float64)
    intensity = shaded(slope, place, light.at(place) if light else np.ones((len(ball), 3)))
    noisy = (intensity + random.normal(0.0, 0.002, intensity.shape)).astype(np.float32)
    return BallSamples(noisy, slope[:, 0], slope[:, 1], column, row, ball), slope


def uneven_light() -> IlluminationMap:
    """Light that falls to a third along the field, differently in each channel."""
    x, y = NODES[..., 0], NODES[..., 1]
    return IlluminationMap(np.stack([1.0 + 0.6 * x, 1.0 - 0.6 * x, 1.0 + 0.6 * y], axis=-1).astype(np.float32))


def test_gentle_slopes_between_and_beyond_balls_are_predicted() -> None:
    skin = GentleSkin.of(*on_balls(), SHAPE)
    random = np.random.default_rng(1)
    slope, place = random.uniform(-0.1, 0.1, (500, 2)), random.uniform(-1.0, 1.0, (500, 2))
    np.testing.assert_allclose(skin.shown(slope, place), shaded(slope, place, np.ones((500, 3))), atol=2e-3)


def test_untouched_skin_shows_its_reference() -> None:
    light = uneven_light()
    skin = GentleSkin.of(*on_balls(light), SHAPE, light)
    place = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 2))
    np.testing.assert_array_equal(skin.shown(np.zeros((20, 2)), place), 1.0)


def test_contrast_that_grows_differently_over_the_field_does_not_turn_the_lights() -> None:
    skin = GentleSkin.of(*on_balls(), SHAPE)
    place = np.array([[0.8, 0.0]])
    slope = np.array([[0.001, 0.0]])
    seen = (skin.shown(slope, place) - 1.0) / 0.001
    np.testing.assert_allclose(seen, towards(place)[:, 0], atol=0.01)


@pytest.mark.parametrize("coloured", [False, True])
def test_balls_left_out_show_whether_the_reference_goes_with_the_lights(coloured: bool) -> None:
    light = uneven_light()
    skin = GentleSkin.best(*on_balls(light if coloured else None), SHAPE, light)
    assert (skin.light is not None) == coloured
    random = np.random.default_rng(2)
    slope, place = random.uniform(-0.1, 0.1, (500, 2)), random.uniform(-0.9, 0.9, (500, 2))
    under = light.at(place) if coloured else np.ones((500, 3))
    np.testing.assert_allclose(skin.shown(slope, place), shaded(slope, place, under), atol=4e-3)


def test_no_gentle_slope_predicts_nothing() -> None:
    samples, slope = on_balls()
    skin = GentleSkin.best(samples, np.sign(slope) * (np.abs(slope) + 0.5), SHAPE, uneven_light())
    np.testing.assert_array_equal(skin.coefficients, 0.0)
