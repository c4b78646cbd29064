"""Slopes that pixels of a camera nearby see of a sphere, beside rays that are followed to it."""

from dataclasses import replace

import numpy as np
import pytest

from device.balls.sphere import Ball, Viewpoint, sphere_slopes

VIEW = Viewpoint(480.0, 360.0, 2000.0)
RADIUS, APEX = 250.0, 110.0


def followed(ball: Ball, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes where the rays of pixels first meet the sphere whose apex is seen at the ball's centre."""
    nearer = 1.0 - APEX / VIEW.height_px
    middle = np.array([VIEW.column, VIEW.row, 0.0])
    apex = np.array([(ball.column - VIEW.column) * nearer, (ball.row - VIEW.row) * nearer, APEX])
    sphere = apex - [0.0, 0.0, RADIUS]
    camera = np.array([0.0, 0.0, VIEW.height_px])
    ray = np.stack([column, row, np.zeros_like(column)], axis=-1) - middle - camera
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    off = camera - sphere
    along = (ray * off).sum(axis=-1)
    normal = off + ray * (-along - np.sqrt(along**2 - (off @ off - RADIUS**2)))[..., None]
    return -normal[..., 0] / normal[..., 2], -normal[..., 1] / normal[..., 2]


@pytest.mark.parametrize("centre", [(480.0, 360.0), (120.0, 90.0), (860.0, 640.0)])
def test_slopes_are_those_where_rays_meet_the_sphere(centre: tuple[float, float]) -> None:
    ball = Ball(*centre, 150.0, RADIUS, VIEW, APEX)
    across, down = np.meshgrid(np.linspace(-105.0, 105.0, 9), np.linspace(-105.0, 105.0, 9))
    column, row = centre[0] + across, centre[1] + down
    found = sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32))
    np.testing.assert_allclose(found, followed(ball, column, row), atol=2e-5)
    straight = sphere_slopes(replace(ball, viewpoint=None), column.astype(np.float32), row.astype(np.float32))
    assert np.abs(np.subtract(found, straight)).max() > 0.02


def test_a_camera_far_away_sees_what_one_straight_above_does() -> None:
    column, row = np.meshgrid(np.arange(60.0, 180.0, 9.0), np.arange(40.0, 160.0, 9.0))
    far, above = (
        sphere_slopes(Ball(120.0, 90.0, 80.0, RADIUS, view, APEX), column.astype(np.float32), row.astype(np.float32))
        for view in (replace(VIEW, height_px=1e9), None)
    )
    np.testing.assert_allclose(far, above, atol=1e-6)


def test_a_frame_with_more_pixels_shows_the_same_slopes() -> None:
    ball = Ball(120.0, 90.0, 80.0, RADIUS, VIEW, APEX)
    column, row = np.array([100.0, 150.0], np.float32), np.array([60.0, 120.0], np.float32)
    larger = sphere_slopes(ball.enlarged(2.0), 2.0 * column + np.float32(0.5), 2.0 * row + np.float32(0.5))
    np.testing.assert_allclose(larger, sphere_slopes(ball, column, row), atol=1e-6)


def test_it_stands_over_the_middle_of_the_field() -> None:
    assert Viewpoint.over_middle(160.0, 12.0, (1088, 1456)) == Viewpoint(
        727.5, 543.5, pytest.approx(13333.33, abs=0.01)
    )
