"""Elevation of balls and of lights over the skin, read from presses whose geometry is known."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from host_sync.uncertainty.elevation import NEAREST_FRACTION, ElevationCorrection, elevation_correction

SHAPE = (240, 320)
RADIUS_PX, CONTACT_PX = 60.0, 30.0
HEIGHT_PX = 400.0


def skin_px(ball: Ball, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """A ball that stands 20 pixels high, with an apron around it."""
    square = (column - ball.column) ** 2 + (row - ball.row) ** 2
    inside = 20.0 - RADIUS_PX + np.sqrt(np.maximum(RADIUS_PX**2 - square, 0.0))
    border = 20.0 - RADIUS_PX + np.sqrt(RADIUS_PX**2 - CONTACT_PX**2)
    return np.where(square < CONTACT_PX**2, inside, border * np.exp(-(np.sqrt(square) - CONTACT_PX) / 15.0))


def map_that_reads(ball: Ball) -> InverseMap:
    """What reads every pixel of a press of this ball rightly."""

    def on_grid(_values: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        at = np.meshgrid(column.astype(float), row.astype(float))
        step = 0.5
        p = (skin_px(ball, at[0] + step, at[1]) - skin_px(ball, at[0] - step, at[1])) / (2 * step)
        q = (skin_px(ball, at[0], at[1] + step) - skin_px(ball, at[0], at[1] - step)) / (2 * step)
        return np.stack([p, q], axis=-1).astype(np.float32)

    return cast(InverseMap, SimpleNamespace(shape=SHAPE, on_grid=on_grid))


def samples(height_px: float = HEIGHT_PX) -> BallSamples:
    """Gentle slopes anywhere in the field, lit by three points."""
    random = np.random.default_rng(0)
    slope = random.uniform(-0.3, 0.3, (3000, 2))
    column, row = random.uniform(0, SHAPE[1], 3000), random.uniform(0, SHAPE[0], 3000)
    angle = np.radians([90.0, 210.0, 330.0])
    across = 160.0 + 700.0 * np.cos(angle)[None] - column[:, None]
    down = 120.0 + 700.0 * np.sin(angle)[None] - row[:, None]
    facing = 1.0 - (slope[:, :1] * across + slope[:, 1:] * down) / height_px
    intensity = facing / np.sqrt(1.0 + (slope**2).sum(axis=1, keepdims=True))
    return BallSamples(
        intensity.astype(np.float32),
        slope[:, 0].astype(np.float32),
        slope[:, 1].astype(np.float32),
        column.astype(np.float32),
        row.astype(np.float32),
        np.zeros(3000, np.intp),
    )


def image_of(valid: np.ndarray | None = None) -> NormalizedImage:
    return NormalizedImage(
        np.ones((*SHAPE, 3), np.float32), np.ones(SHAPE, bool) if valid is None else valid, np.zeros(SHAPE, bool)
    )


def measured(*, without_balls: int = 0) -> ElevationCorrection:
    ball = Ball(150.0, 110.0, CONTACT_PX, RADIUS_PX)
    presses: list[tuple[NormalizedImage, list[Ball]]] = [(image_of(), [])] * without_balls
    return elevation_correction([*presses, (image_of(), [ball])], samples(), map_that_reads(ball))


def test_balls_and_lights_are_measured_over_the_skin() -> None:
    found = measured()
    assert found.apex_px == pytest.approx(20.0, rel=0.1)
    assert found.radius_px == RADIUS_PX
    assert 1.0 / found.nearness_per_px == pytest.approx(HEIGHT_PX, rel=0.02)


def test_a_slope_at_the_balls_own_elevation_is_read_right_and_a_lower_one_too_flat() -> None:
    taught = ElevationCorrection(20.0, 60.0, 1.0 / 400.0)
    square = np.array([0.0, 0.2], np.float32)
    own = 20.0 - 60.0 * (1.0 - 1.0 / np.sqrt(1.0 + square))
    np.testing.assert_allclose(taught.steeper(own.astype(np.float32), square), 0.0, atol=1e-6)
    np.testing.assert_allclose(taught.steeper((own - 8.0).astype(np.float32), square), -0.02, atol=1e-6)


def test_another_size_of_the_same_field_says_the_same() -> None:
    taught = ElevationCorrection(20.0, 60.0, 1.0 / 400.0)
    z, square = np.float32([3.0, 9.0]), np.float32([0.1, 0.3])
    np.testing.assert_allclose(taught.enlarged(2.5).steeper(2.5 * z, square), taught.steeper(z, square), rtol=1e-5)


def test_lights_are_never_taken_to_stand_among_the_balls() -> None:
    ball = Ball(150.0, 110.0, CONTACT_PX, RADIUS_PX)
    low = elevation_correction([(image_of(), [ball])], samples(50.0), map_that_reads(ball))
    assert low.nearness_per_px == pytest.approx(NEAREST_FRACTION / low.apex_px)


def test_presses_whose_balls_were_all_rejected_are_passed_over() -> None:
    assert measured(without_balls=5) == measured()


def test_pixels_without_an_intensity_spoil_nothing() -> None:
    valid = np.ones(SHAPE, bool)
    valid[:40, 200:] = False
    image = image_of(valid)
    image.values[~valid] = np.nan
    ball = Ball(150.0, 110.0, CONTACT_PX, RADIUS_PX)
    inverse = map_that_reads(ball)
    right = inverse.on_grid

    def on_grid(values: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        return right(values, column, row) * values[..., :1]

    spoilt = cast(InverseMap, SimpleNamespace(shape=SHAPE, on_grid=on_grid))
    assert elevation_correction([(image, [ball])], samples(), spoilt).apex_px == pytest.approx(20.0, rel=0.1)


def test_a_field_without_untouched_skin_still_shows_a_ball_over_its_rim() -> None:
    ball = Ball(150.0, 110.0, CONTACT_PX, RADIUS_PX)

    def on_grid(_values: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        return np.zeros((len(row), len(column), 2), np.float32)

    flat = cast(InverseMap, SimpleNamespace(shape=SHAPE, on_grid=on_grid))
    rise_px = RADIUS_PX - np.sqrt(RADIUS_PX**2 - CONTACT_PX**2)
    assert elevation_correction([(image_of(), [ball])], samples(), flat).apex_px == pytest.approx(rise_px)
