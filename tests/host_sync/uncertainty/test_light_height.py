"""The lights' height over the skin, from balls under lights that stand at a known one."""

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples, gather_samples, sphere_slopes
from device.imaging.flat_field import NormalizedImage
from host_sync.uncertainty.elevation import nearness_per_px

SHAPE = (240, 320)
HEIGHT_PX = 400.0
CORNERS = [(50.0, 50.0), (270.0, 50.0), (50.0, 190.0), (270.0, 190.0)]


def press(place: tuple[float, float], height_px: float, contact_px: float) -> tuple[NormalizedImage, list[Ball]]:
    """A matt ball, each channel lit by a point of its own; with noise."""
    ball = Ball(*place, contact_px, 60.0)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    p, q = sphere_slopes(ball, column, row)
    angle = np.radians([90.0, 210.0, 330.0])
    across = 160.0 + 1.75 * height_px * np.cos(angle) - column[..., None]
    down = 120.0 + 1.75 * height_px * np.sin(angle) - row[..., None]
    facing = 1.0 - (p[..., None] * across + q[..., None] * down) / height_px
    noise = 0.02 * np.random.default_rng(int(place[0])).standard_normal(facing.shape)
    values = facing / np.sqrt(1.0 + p**2 + q**2)[..., None] + noise
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool)), [ball]


def samples(places: list[tuple[float, float]], height_px: float = HEIGHT_PX, contact_px: float = 20.0) -> BallSamples:
    return gather_samples([press(place, height_px, contact_px) for place in places])


@pytest.mark.parametrize("places", [CORNERS, [(column, 120.0) for column in (40.0, 120.0, 200.0, 280.0)]])
def test_four_balls_show_it_in_the_corners_and_in_a_row(places: list[tuple[float, float]]) -> None:
    assert 1.0 / nearness_per_px(samples(places), SHAPE) == pytest.approx(HEIGHT_PX, rel=0.05)


def test_lights_far_away_have_no_nearness() -> None:
    assert nearness_per_px(samples(CORNERS, 1e6), SHAPE) < 0.02 / HEIGHT_PX


def test_where_no_slope_is_gentle_nothing_is_claimed() -> None:
    whole = samples(CORNERS, contact_px=30.0)
    steep = np.hypot(whole.p, whole.q) > 0.4
    parts = (part[steep] for part in (whole.intensity, whole.p, whole.q, whole.column, whole.row, whole.ball))
    assert nearness_per_px(BallSamples(*parts), SHAPE) == 0.0
