"""Gains of balls: what one tells of each band of tilt, what of it is believed, and what is drawn from it."""

import numpy as np
import pytest

from device.balls.sphere import Ball, sphere_slopes
from host_sync.uncertainty.calibration_uncertainty import (
    CLOSE_WIDTHS,
    believed_gains,
    gain_at,
    gain_curves,
    gains_by_place,
    gains_of_ball,
    local_normals,
    shared_and_local,
)
from host_sync.uncertainty.height_error import SAMPLES, _normals

BANDS = ((0.0, 4.0), (4.0, 10.0), (10.0, 20.0), (20.0, 30.0), (30.0, 40.0))
BALL = Ball(60.0, 60.0, 50.0, 90.0)


def truth() -> tuple[np.ndarray, np.ndarray]:
    """True slopes (2, h, w) of a ball, and its contact."""
    row, column = np.mgrid[:121, :121].astype(np.float32)
    inside = (column - BALL.column) ** 2 + (row - BALL.row) ** 2 < BALL.contact_radius_px**2
    return np.stack(sphere_slopes(BALL, column, row)).astype(np.float64), inside


def test_a_share_by_which_all_slopes_are_off_is_found_by_every_band() -> None:
    slope, inside = truth()
    gain, variance = gains_of_ball(-0.03 * slope, slope, inside, BANDS)
    np.testing.assert_allclose(gain, -0.03)
    np.testing.assert_allclose(variance, 0.0, atol=1e-12)


def test_steep_slopes_alone_may_be_off() -> None:
    slope, inside = truth()
    steep = np.hypot(*slope) > np.tan(np.radians(30.0))
    gain, _ = gains_of_ball(np.where(steep, 0.1 * slope, 0.0), slope, inside, BANDS)
    np.testing.assert_allclose(gain, [0.0, 0.0, 0.0, 0.0, 0.1], atol=1e-9)


def test_a_centre_that_is_off_is_no_gain() -> None:
    slope, inside = truth()
    gain, variance = gains_of_ball(np.full_like(slope, 0.02), slope, inside, BANDS)
    np.testing.assert_allclose(gain, 0.0, atol=2e-3)
    assert variance.max() < 1e-4


def test_noise_is_not_believed_and_what_balls_agree_on_is() -> None:
    slope, inside = truth()
    rng = np.random.default_rng(0)
    noisy = [gains_of_ball(0.1 * rng.standard_normal(slope.shape), slope, inside, BANDS) for _ in range(40)]
    sure = [(gain + 0.05, variance) for gain, variance in noisy]
    told = np.sqrt((np.array([gain for gain, _ in noisy]) ** 2).mean(axis=0))
    believed = np.sqrt((np.array(believed_gains(noisy)) ** 2).mean(axis=0))
    assert believed.mean() < 0.5 * told.mean()
    np.testing.assert_allclose(np.sqrt((np.array(believed_gains(sure)) ** 2).mean(axis=0)), 0.05, rtol=0.15)


def test_a_ball_that_shows_nothing_shows_nothing() -> None:
    slope, inside = truth()
    nothing = gains_of_ball(slope, slope, np.zeros_like(inside), BANDS)
    assert np.isnan(nothing[0]).all()
    assert believed_gains([nothing]) == ()
    assert gain_curves(()).shape == (0, 0)


def test_curves_have_the_mean_square_of_the_balls_and_their_correlation() -> None:
    gains = np.random.default_rng(0).standard_normal((12, 5)) * 0.01
    curves = gain_curves(gains.tolist())
    np.testing.assert_allclose(curves.T @ curves, gains.T @ gains / 12, atol=1e-12)


def test_a_gain_runs_straight_between_tilts_and_stays_beyond() -> None:
    cosine = np.cos(np.radians(np.array([0.0, 5.0, 25.0, 60.0], np.float32)))
    found = gain_at(np.array([0.01, 0.03]), cosine, (5.0, 25.0))
    np.testing.assert_allclose(found, [0.01, 0.01, 0.03, 0.03], atol=1e-6)


@pytest.mark.parametrize("count", [3, SAMPLES - 1, SAMPLES + 4])
def test_what_errs_everywhere_is_drawn_with_its_exact_mean_and_variance(count: int) -> None:
    normal = _normals(np.random.default_rng(0), count)
    some = normal[:, : min(count, SAMPLES - 1)]
    np.testing.assert_allclose(some.T @ some / SAMPLES, np.eye(some.shape[1]), atol=1e-5)
    np.testing.assert_allclose(some.mean(axis=0), 0.0, atol=1e-6)
    assert normal.shape == (SAMPLES, count)


def test_no_draw_prefers_a_sign() -> None:
    drawn = np.array([np.diag(_normals(np.random.default_rng(seed), 6)) for seed in range(400)])
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.2)


def test_what_balls_agree_on_is_believed_though_their_sectors_differ() -> None:
    slope, inside = truth()
    wrong = np.stack([-0.15 * slope[0], 0.09 * slope[1]])
    gains = believed_gains([gains_of_ball(wrong, slope, inside, BANDS)] * 3)
    np.testing.assert_allclose(gains, -0.03, atol=0.01)


def test_a_ball_that_shows_one_sector_says_nothing_of_its_scatter() -> None:
    slope, inside = truth()
    one = inside & (slope[1] > 0.0) & (slope[1] < 0.9 * slope[0])
    _, variance = gains_of_ball(0.1 * np.random.default_rng(0).standard_normal(slope.shape), slope, one, BANDS)
    assert np.isnan(variance).all()


def test_gains_of_balls_close_by_count_most() -> None:
    gains, places = [(0.01, 0.01), (0.04, 0.04)], [(0.1, 0.4), (0.9, 0.4)]
    share = gains_by_place(gains, places, (100, 80))
    whole = np.sqrt((0.01**2 + 0.04**2) / 2)
    assert share.shape == (80, 100)
    assert share[40, 10] * whole == pytest.approx(0.01, rel=0.3)
    assert share[40, 90] * whole == pytest.approx(0.04, rel=0.05)
    assert share[40, 50] == pytest.approx(1.0, abs=0.05)


def test_gains_without_places_count_alike_everywhere() -> None:
    for gains, places in (([(0.01,), (0.04,)], ()), ((), ()), ([(0.0,)], [(0.5, 0.5)])):
        np.testing.assert_array_equal(gains_by_place(gains, places, (5, 4)), np.ones((4, 5)))


def test_what_all_balls_have_is_shared_and_the_rest_is_local() -> None:
    gains = 0.02 + 0.01 * np.random.default_rng(0).standard_normal((12, 5))
    places = [(0.1 * number, 0.5) for number in range(12)]
    shared, local = shared_and_local(gains.tolist(), places)
    np.testing.assert_allclose(shared.T @ shared + local.T @ local, gains.T @ gains / 12, atol=1e-12)
    np.testing.assert_allclose(np.abs(shared[0]), gains.mean(axis=0), atol=1e-12)
    alone, nothing = shared_and_local(gains.tolist(), ())
    assert len(alone) == 5
    assert len(nothing) == 0


def test_local_draws_have_variance_one_everywhere_and_are_alike_close_by() -> None:
    drawn = local_normals(np.random.default_rng(0), (SAMPLES, 40, 36, 48))
    np.testing.assert_allclose(np.square(drawn).mean(axis=0), 1.0, atol=1e-4)
    for apart, alike in ((round(0.3 * CLOSE_WIDTHS * 48), 0.97), (24, 0.1)):
        share = (drawn[..., :-apart] * drawn[..., apart:]).mean()
        assert share == pytest.approx(alike, abs=0.1)


def test_without_local_curves_nothing_is_drawn() -> None:
    assert local_normals(np.random.default_rng(0), (SAMPLES, 0, 4, 5)).shape == (SAMPLES, 0, 4, 5)
