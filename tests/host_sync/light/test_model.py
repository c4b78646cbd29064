"""The light model against closed forms and a renderer of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matt_light import matt_model
from near_lamps import SHAPE, NearLamps

from host_sync.light.model import LightModel

HEIGHT_PX = 220.0
MATT = matt_model(HEIGHT_PX)
COUNT = 60
RANDOM = np.random.default_rng(0)
COLUMN, ROW = RANDOM.uniform(0, SHAPE[1] - 1, COUNT), RANDOM.uniform(0, SHAPE[0] - 1, COUNT)
Z_PX = RANDOM.uniform(-10.0, 20.0, COUNT)
SLOPE = RANDOM.uniform(-0.4, 0.4, (COUNT, 2))
DARK = np.zeros((COUNT, 3))
EVERYTHING = replace(
    MATT,
    sources=MATT.sources + np.array([0.0, 0.0, 0.0, 0.4, 0.5]),
    strengths=np.eye(3) + 0.1,
    haze=np.full(3, 0.05),
    albedo=0.4,
    fall_off=1.4,
    roughness=0.5,
    gloss=0.3,
    tilt_gain=0.1,
    scattering=0.2,
    beam=0.5,
    camera=0.3,
    residual=RANDOM.normal(0.0, 0.1, MATT.residual.shape),
)
"""A model of which no part is missing."""


def towards_first() -> tuple[np.ndarray, float]:
    """Return the horizontal direction of the first lamp from the middle, and its angle from the vertical."""
    right, down, up = MATT.sources[0, :3]
    away = np.hypot(right, down)
    return np.array([right, down]) / away, float(np.arctan2(away, up))


def intensity_at_the_middle(model: LightModel, slope: np.ndarray) -> np.ndarray:
    """Return the first channel's intensity of slopes (N, 2) at the middle of the field."""
    places = model.places(*(np.full(len(slope), 0.5 * (size - 1)) for size in SHAPE[::-1]), np.zeros(len(slope)))
    return model.intensity(slope, places, np.zeros((len(slope), 3)))[:, 0]


@pytest.mark.parametrize("model", [MATT, EVERYTHING], ids=["matt", "everything"])
def test_level_skin_at_rest_is_exactly_one(model: LightModel) -> None:
    shown = model.intensity(np.zeros((COUNT, 2)), model.places(COLUMN, ROW, np.zeros(COUNT)), DARK)
    np.testing.assert_array_equal(shown, 1.0)


def test_matt_skin_under_points_is_that_of_the_renderer() -> None:
    lamps, row, column = NearLamps(HEIGHT_PX), ROW.astype(int), COLUMN.astype(int)
    shown = MATT.intensity(SLOPE, MATT.places(column.astype(float), row.astype(float), Z_PX), DARK)
    field = np.zeros((3, *SHAPE))
    rest = lamps.light(*field)[row, column]
    field[:, row, column] = Z_PX, *SLOPE.T
    np.testing.assert_allclose(shown, lamps.light(*field)[row, column] / rest, rtol=1e-9, atol=1e-12)


def test_neither_brightness_nor_the_number_of_pixels_matters() -> None:
    model = replace(EVERYTHING, residual=np.zeros_like(EVERYTHING.residual))
    shown = model.intensity(SLOPE, model.places(COLUMN, ROW, Z_PX), DARK)
    brighter = replace(model, strengths=3.0 * model.strengths, haze=3.0 * model.haze)
    np.testing.assert_allclose(brighter.intensity(SLOPE, model.places(COLUMN, ROW, Z_PX), DARK), shown, rtol=1e-12)
    finer = replace(model, shape=(2 * SHAPE[0], 2 * SHAPE[1]))
    places = finer.places(2.0 * COLUMN + 0.5, 2.0 * ROW + 0.5, 2.0 * Z_PX)
    np.testing.assert_allclose(finer.intensity(SLOPE, places, DARK), shown, rtol=1e-12)


def test_a_panel_lights_as_points_over_it() -> None:
    """It stands upright across the way to the middle; its height is stated relative to its elevation."""
    right, down, up = MATT.sources[0, :3]
    length, height, count = 0.4, 0.5, 31
    across = np.array([-down, right, 0.0]) / np.hypot(right, down)
    middle = np.array([right, down, up])
    parts = (np.arange(count) + 0.5) / count - 0.5
    along, upward = (grid.reshape(-1, 1) for grid in np.meshgrid(length * parts, height * up * parts))
    points = middle + along * across + upward * [0.0, 0.0, 1.0]
    bright = (np.linalg.norm(middle) / np.linalg.norm(points, axis=1)) ** MATT.fall_off / len(points)
    many = np.column_stack([points, np.zeros((len(points), 2))])
    lit = replace(MATT, sources=many, strengths=np.tile(bright, (3, 1)))
    panel = replace(MATT, sources=np.array([[right, down, up, length, height]]), strengths=np.ones((3, 1)))
    places = MATT.places(COLUMN, ROW, Z_PX)
    np.testing.assert_allclose(panel.intensity(SLOPE, places, DARK), lit.intensity(SLOPE, places, DARK), atol=3e-3)
    point = replace(panel, sources=panel.sources * [1.0, 1.0, 1.0, 0.0, 0.0])
    assert np.abs(point.intensity(SLOPE, places, DARK) - lit.intensity(SLOPE, places, DARK)).max() > 6e-3


def test_a_coat_that_shines_is_brightest_where_it_mirrors_the_lamp_to_the_camera() -> None:
    towards, angle = towards_first()
    slope = np.linspace(-1.2, 1.2, 1201)
    shown = intensity_at_the_middle(replace(MATT, gloss=0.9, gloss_width=0.1), -slope[:, None] * towards)
    assert slope[shown.argmax()] == pytest.approx(np.tan(0.5 * angle), abs=0.03)


def test_a_near_camera_sees_the_mirrored_lamp_on_other_slopes() -> None:
    """Half way between the direction to the lamp and that to the camera, at a place off the middle."""
    height, x = 2.0, 0.39
    near = replace(MATT, gloss=0.9, gloss_width=0.1, camera=1.0 / height)
    slope = np.linspace(-1.2, 1.2, 1201)
    lamp, camera = MATT.sources[0, :3] - [x, 0.0, 0.0], np.array([-x, 0.0, height])
    half = lamp / np.linalg.norm(lamp) + camera / np.linalg.norm(camera)
    down = np.full_like(slope, -half[1] / half[2])
    level = np.zeros_like(slope)
    shown = near.intensity(
        np.stack([slope, down], axis=-1), (np.full_like(slope, x), level, level), np.zeros((len(slope), 3))
    )
    assert abs(half[0] / half[2]) > 0.05
    assert slope[shown[:, 0].argmax()] == pytest.approx(-half[0] / half[2], abs=0.05)


def test_a_large_tail_power_leaves_less_light_far_from_the_mirror() -> None:
    towards, angle = towards_first()
    half = np.tan(0.5 * angle)
    slope = -np.array([half, half - 0.6])[:, None] * towards
    left = []
    for tail in (2.0, 60.0):
        shown = intensity_at_the_middle(replace(MATT, gloss=0.999, gloss_width=0.15, tail=tail), slope)
        left.append(shown[1] / shown[0])
    assert left[1] < 0.2 * left[0]


def test_light_from_skin_around_is_reflected_by_the_albedo() -> None:
    around = RANDOM.uniform(0.0, 1.0, (COUNT, 3))
    places = EVERYTHING.places(COLUMN, ROW, Z_PX)
    gain = EVERYTHING.intensity(SLOPE, places, around) - EVERYTHING.intensity(SLOPE, places, DARK)
    np.testing.assert_allclose(gain, EVERYTHING.albedo * around, atol=1e-12)


def test_the_error_is_that_of_balls_up_to_their_slopes_and_grows_beyond() -> None:
    slope = MATT.steepest * np.array([[0.0, 0.0], [0.6, 0.6], [0.0, 1.05], [1.2, 0.0]])
    variance = MATT.variance(slope)[:, 0]
    np.testing.assert_allclose(variance[:2], MATT.sigma[0] ** 2, rtol=1e-12)
    assert variance[1] < variance[2] < variance[3]


def test_the_more_exact_the_model_the_less_is_left_of_an_uncertain_slope() -> None:
    left = [matt_model(HEIGHT_PX, sigma).uncertain_fraction(0.05) for sigma in (1e-4, 0.01, 0.1, 100.0)]
    assert left == sorted(left)
    assert left[0] < 1e-3
    assert left[-1] > 0.999


def test_sources_are_believed_as_far_as_they_alone_determine_slopes() -> None:
    """The residual field does not count: it predicts no elevation."""
    believed = [replace(MATT, source_sigma=np.full(3, sigma)).believed_fraction(0.05) for sigma in (1e-4, 0.05, 1e3)]
    assert believed == sorted(believed, reverse=True)
    assert believed[0] > 0.999
    assert believed[-1] < 1e-3
    with_residual = replace(EVERYTHING, residual=0.0 * EVERYTHING.residual)
    assert EVERYTHING.believed_fraction(0.05) == with_residual.believed_fraction(0.05)


def test_sources_that_leave_a_part_of_the_field_dark_are_found() -> None:
    assert MATT.lights_field
    assert EVERYTHING.lights_field
    behind = MATT.sources.copy()
    behind[0, :3] = -0.2, 0.0, 0.05  # over the field, its beam turned to the middle: skin behind it gets none
    assert not replace(MATT, sources=behind, beam=1.0).lights_field
    assert not replace(MATT, strengths=np.zeros((3, 3))).lights_field
