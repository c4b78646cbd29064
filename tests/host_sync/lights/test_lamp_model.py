"""What the model of lamps and coat shows, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from point_lamps import POSITION, point_lamps

from host_sync.lights.lamp_model import LampModel

SHAPE = (300, 400)
POINTS = point_lamps(SHAPE)
RANDOM = np.random.default_rng(0)
COLUMN, ROW = RANDOM.uniform(0, 399, 50), RANDOM.uniform(0, 299, 50)
P, Q, Z_PX = RANDOM.uniform(-0.3, 0.3, 50), RANDOM.uniform(-0.3, 0.3, 50), RANDOM.uniform(0, 30, 50)


def across_px(channel: int) -> np.ndarray:
    """From each place to the lamp, (2, N)."""
    middle = np.array([[199.5], [149.5]])
    return 400.0 * POSITION[channel, :2, None] + middle - np.stack([COLUMN, ROW])


@pytest.mark.parametrize(
    "model",
    [
        POINTS,
        replace(
            POINTS,
            strip=0.4,
            fall_off=1.4,
            haze=np.full(3, 0.05),
            roughness=0.5,
            gloss=0.3,
            bounce_close=0.4,
            camera=0.3,
        ),
    ],
)
def test_untouched_skin_shows_1(model: LampModel) -> None:
    zero = np.zeros(50)
    np.testing.assert_allclose(model.shown(zero, zero, COLUMN, ROW, zero), 1.0, rtol=1e-12)


def test_matt_skin_under_points_follows_the_law_of_cosine_and_distance() -> None:
    shown = POINTS.shown(P, Q, COLUMN, ROW, Z_PX)
    for channel in range(3):
        across, above = across_px(channel), 400.0 * POSITION[channel, 2]

        def lit(z_px: np.ndarray, p: np.ndarray, q: np.ndarray, across: np.ndarray = across, above: float = above):
            facing = above - z_px - p * across[0] - q * across[1]
            return facing / np.sqrt(1 + p**2 + q**2) / ((across**2).sum(axis=0) + (above - z_px) ** 2) ** 1.5

        zero = np.zeros(50)
        wanted = np.maximum(lit(Z_PX, P, Q), 0.0) / lit(zero, zero, zero)
        np.testing.assert_allclose(shown[:, channel], wanted, rtol=1e-9, atol=1e-12)


def test_a_coat_that_shines_is_brightest_where_it_mirrors_the_lamp_to_the_camera() -> None:
    shining = replace(POINTS, gloss=0.9, gloss_width=0.1)
    slope = np.linspace(-0.8, 0.8, 801)
    middle = np.full_like(slope, 199.5), np.full_like(slope, 149.5)
    towards = POSITION[0, :2] / np.hypot(*POSITION[0, :2])
    shown = shining.shown(-slope * towards[0], -slope * towards[1], *middle, np.zeros_like(slope))
    half_angle = 0.5 * np.arctan2(np.hypot(*POSITION[0, :2]), POSITION[0, 2])
    assert slope[shown[:, 0].argmax()] == pytest.approx(np.tan(half_angle), abs=0.02)


def test_a_near_camera_sees_the_mirrored_lamp_on_other_slopes() -> None:
    """At a place beside the middle: half way between the direction to the lamp and that to the camera."""
    near = replace(POINTS, gloss=0.9, gloss_width=0.1, camera=0.5)
    slope, column, row = np.linspace(-0.8, 0.8, 801), 349.5, 149.5
    there = np.full_like(slope, column), np.full_like(slope, row)
    seen = []
    for axis in (0, 1):
        p, q = (slope if axis == k else np.zeros_like(slope) for k in (0, 1))
        shown = near.shown(p, q, *there, np.zeros_like(slope))[:, 0] * np.sqrt(1.0 + slope**2)
        seen.append(slope[shown.argmax()])
    lamp = POSITION[0] - np.array([(column - 199.5) / 400.0, 0.0, 0.0])
    camera = np.array([-(column - 199.5) / 400.0, 0.0, 2.0])
    half = lamp / np.linalg.norm(lamp) + camera / np.linalg.norm(camera)
    assert seen[0] == pytest.approx(-half[0] / half[2], abs=0.05)
    assert abs(-half[0] / half[2]) > 0.1


def test_a_long_tail_power_makes_a_lobe_that_falls_as_a_gaussian() -> None:
    """Of the same width at the middle: far from it a lobe of power 2 is left, a Gaussian one is not."""
    middle = np.full(2, 199.5), np.full(2, 149.5)
    towards = POSITION[0, :2] / np.hypot(*POSITION[0, :2])
    half = np.tan(0.5 * np.arctan2(np.hypot(*POSITION[0, :2]), POSITION[0, 2]))
    slope = np.array([half, half - 0.6])
    left = []
    for tail in (2.0, 60.0):
        shining = replace(POINTS, gloss=0.999, gloss_width=0.15, tail=tail)
        shown = shining.shown(-slope * towards[0], -slope * towards[1], *middle, np.zeros(2))[:, 0]
        left.append(shown[1] / shown[0])
    assert left[1] < 0.2 * left[0]


def test_a_strip_of_no_length_is_a_point_and_a_mixture_lies_between_its_lamps() -> None:
    mixed = replace(POINTS, mixing=np.eye(3) * 0.4 + 0.3).shown(P, Q, COLUMN, ROW, Z_PX)
    alone = POINTS.shown(P, Q, COLUMN, ROW, Z_PX)
    assert (mixed < alone.max(axis=1, keepdims=True) + 1e-12).all()
    assert (mixed > alone.min(axis=1, keepdims=True) - 1e-12).all()
    thin = replace(POINTS, strip=1e-9).shown(P, Q, COLUMN, ROW, Z_PX)
    np.testing.assert_allclose(thin, alone, rtol=1e-6)


def test_slanted_skin_receives_light_of_skin_close_by_and_afar() -> None:
    close = RANDOM.uniform(0.5, 1.5, (50, 3))
    direct = POINTS.shown(P, Q, COLUMN, ROW, Z_PX)
    lit = replace(POINTS, bounce_close=0.28, bounce_afar=0.12).shown(P, Q, COLUMN, ROW, Z_PX, close)
    tilted = 1.0 - np.cos(np.arctan(np.hypot(P, Q)))[:, None]
    np.testing.assert_allclose(lit - direct, tilted * (0.12 + 0.28 * close), rtol=1e-9, atol=1e-12)
