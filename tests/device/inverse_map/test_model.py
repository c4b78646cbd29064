"""The inverse map on a world with a known answer: three lights over balls, near or far."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples, gather_samples, sphere_slopes
from device.calibration.cross_validation import angle_between_deg
from device.calibration.fit import InverseFit, fit_inverse_map
from device.errors import CalibrationError, CalibrationMismatch, RecordError
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.inverse_map.near_light import IlluminationMap
from device.inverse_map.regressor import colour_exponents, monomials, position_exponents
from device.surface import slope_from_stereographic, stereographic_from_slope

SHAPE = (240, 320)
RADIUS_PX = 50.0
CONTACT_PX = 32.0


def intensity_of(p: np.ndarray, q: np.ndarray, column: np.ndarray, row: np.ndarray, *, near: bool) -> np.ndarray:
    """Lambertian shading by three lights 120 degrees apart; near lights turn with the place in the field."""
    channels = []
    for angle in np.radians([90.0, 210.0, 330.0]):
        x, y, z = 300.0 * np.cos(angle), 300.0 * np.sin(angle), 180.0
        dx, dy = (x - (column - 160.0), y - (row - 120.0)) if near else (x + 0 * column, y + 0 * row)
        distance = np.sqrt(dx**2 + dy**2 + z**2)
        flat = z / distance
        shade = (-p * dx - q * dy + z) / distance / np.sqrt(1 + p**2 + q**2)
        channels.append(np.maximum(shade, 0.0) / flat)
    return np.stack(channels, axis=-1).astype(np.float32)


def press(ball: Ball, *, near: bool, noise: float = 0.01, seed: int = 0) -> NormalizedImage:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    p, q = sphere_slopes(ball, column, row)
    inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 <= ball.contact_radius_px**2
    p, q = np.where(inside, p, 0.0), np.where(inside, q, 0.0)
    values = intensity_of(p, q, column, row, near=near)
    values = values + noise * np.random.default_rng(seed).standard_normal(values.shape).astype(np.float32)
    return NormalizedImage(values, np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def balls() -> list[Ball]:
    places = [(column, row) for row in (45.0, 120.0, 195.0) for column in (50.0, 125.0, 200.0, 270.0)]
    return [Ball(column, row, CONTACT_PX, RADIUS_PX) for column, row in places]


def fitted_to(given: list[Ball], *, near: bool, light: IlluminationMap | None = None) -> InverseFit:
    true = balls()
    presses = [
        (press(ball, near=near, seed=number), [label])
        for number, (ball, label) in enumerate(zip(true, given, strict=True))
    ]
    return fit_inverse_map(gather_samples(presses), given, SHAPE, max_samples=12_000, light=light)


@cache
def fitted(*, near: bool) -> InverseFit:
    return fitted_to(balls(), near=near)


def error_deg(found: InverseMap, ball: Ball, *, near: bool) -> float:
    gradients = found.gradients(press(ball, near=near, noise=0.0))
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    inside = (column - ball.column) ** 2 + (row - ball.row) ** 2 <= (0.95 * ball.contact_radius_px) ** 2
    slope = np.stack([gradients.p[inside], gradients.q[inside]], axis=-1).astype(np.float64)
    truth = np.stack(sphere_slopes(ball, column[inside], row[inside]), axis=-1).astype(np.float64)
    return float(angle_between_deg(slope, truth).mean())


def test_stereographic_slopes_round_trip() -> None:
    slope = np.random.default_rng(0).normal(0.0, 1.0, (200, 2))
    np.testing.assert_allclose(slope_from_stereographic(stereographic_from_slope(*slope.T)), slope, rtol=1e-9)


def test_monomials_are_products_of_powers() -> None:
    variables = np.random.default_rng(0).normal(size=(5, 3))
    table = monomials(variables, 3)
    for column, (i, j, k) in zip(table.T, colour_exponents(3), strict=True):
        np.testing.assert_allclose(column, variables[:, 0] ** i * variables[:, 1] ** j * variables[:, 2] ** k)
    place = monomials(variables[:, :2], 2)
    for column, (i, j) in zip(place.T, position_exponents(2), strict=True):
        np.testing.assert_allclose(column, variables[:, 0] ** i * variables[:, 1] ** j)


@pytest.mark.parametrize("near", [False, True])
def test_an_unseen_ball_is_read_to_under_a_degree(near: bool) -> None:
    found = fitted(near=near)
    assert error_deg(found.map, Ball(160.0, 90.0, CONTACT_PX, RADIUS_PX), near=near) < 0.7
    assert found.held_out_deg is not None
    assert found.held_out_deg < 1.5
    assert found.kept.all()


def test_with_a_reference_what_near_lights_say_of_slopes_is_read_where_no_light_sets() -> None:
    even = IlluminationMap(np.ones((2, 2, 3), np.float32))
    gentle = [replace(ball, contact_radius_px=22.0) for ball in balls()]
    presses = [(press(ball, near=True, seed=number), [ball]) for number, ball in enumerate(gentle)]
    found, by_intensity = (
        fit_inverse_map(gather_samples(presses), gentle, SHAPE, max_samples=12_000, light=light)
        for light in (even, None)
    )
    assert found.map.near is not None
    assert by_intensity.map.near is None
    between = Ball(160.0, 90.0, 22.0, RADIUS_PX)
    assert found.held_out_deg is not None
    assert by_intensity.held_out_deg is not None
    assert found.held_out_deg < by_intensity.held_out_deg
    assert error_deg(found.map, between, near=True) < 0.1
    again = InverseMap.from_arrays(found.map.arrays(), "model")
    image = press(between, near=True)
    np.testing.assert_array_equal(again.gradients(image).p, found.map.gradients(image).p)
    single = found.map.predict(image.values[90, 150:155], np.arange(150.0, 155.0, dtype=np.float32), np.full(5, 90.0))
    np.testing.assert_allclose(found.map.gradients(image).p[90, 150:155], single[:, 0], atol=1e-5)
    steep = fitted_to(balls(), near=True, light=even)
    assert steep.map.near is None


def test_near_lights_need_position() -> None:
    assert fitted(near=True).map.curve.position_degree > 0


def test_block_evaluation_agrees_with_prediction_of_single_pixels() -> None:
    found = fitted(near=True).map
    image = press(balls()[5], near=True)
    gradients = found.gradients(image)
    row, column = np.array([3, 100, 239]), np.array([7, 200, 319])
    single = found.predict(image.values[row, column], column.astype(np.float32), row.astype(np.float32))
    np.testing.assert_allclose(gradients.p[row, column], single[:, 0], atol=1e-4)
    np.testing.assert_allclose(gradients.q[row, column], single[:, 1], atol=1e-4)


def test_a_grid_of_places_is_read_as_whole_rows_are() -> None:
    found = fitted(near=True).map
    image = press(balls()[5], near=True)
    gradients = found.gradients(image)
    row, column = np.arange(2, 240, 3), np.array([0, 7, 200, 319])
    slopes = found.on_grid(image.values[np.ix_(row, column)], column, row)
    np.testing.assert_allclose(slopes[..., 0], gradients.p[np.ix_(row, column)], atol=1e-6)
    np.testing.assert_allclose(slopes[..., 1], gradients.q[np.ix_(row, column)], atol=1e-6)


def test_a_binned_image_is_read_at_the_same_places() -> None:
    found = fitted(near=True).map
    image = press(balls()[5], near=True, noise=0.0)
    binned = NormalizedImage(
        image.values.reshape(120, 2, 160, 2, 3).mean(axis=(1, 3)),
        np.ones((120, 160), bool),
        np.zeros((120, 160), bool),
    )
    full = found.gradients(image).p.reshape(120, 2, 160, 2).mean(axis=(1, 3))
    inside = np.abs(found.gradients(binned, 2).p - full)
    assert np.median(inside) < 0.005


def test_centres_labelled_wrong_are_moved_back() -> None:
    true = balls()
    off = np.random.default_rng(3).uniform(-2.5, 2.5, (len(true), 2))
    off -= np.median(off, axis=0)
    labels = [
        Ball(ball.column + dx, ball.row + dy, ball.contact_radius_px - 3.0, RADIUS_PX)
        for ball, (dx, dy) in zip(true, off, strict=True)
    ]
    found = fitted_to(labels, near=True)
    left = np.array([[b.column - t.column, b.row - t.row] for b, t in zip(found.balls, true, strict=True)])
    assert np.abs(left - np.median(left, axis=0)).mean() < 0.4 * np.abs(off).mean()


def test_a_label_from_another_frame_is_rejected() -> None:
    labels = balls()
    labels[4] = Ball(labels[4].column + 18.0, labels[4].row - 14.0, CONTACT_PX, RADIUS_PX)
    found = fitted_to(labels, near=False)
    assert not found.kept[4]
    assert found.kept.sum() == len(labels) - 1


def test_of_few_balls_none_is_rejected_for_standing_in_its_corner() -> None:
    corners = [balls()[number] for number in (0, 3, 8, 11)]
    presses = [(press(ball, near=True, seed=number), [ball]) for number, ball in enumerate(corners)]
    found = fit_inverse_map(gather_samples(presses), corners, SHAPE, max_samples=12_000)
    assert found.kept.all()


def test_a_label_from_another_frame_is_rejected_among_few_balls_too() -> None:
    true = [balls()[number] for number in (0, 3, 5, 6, 8, 11)]
    labels = [*true[:2], Ball(true[2].column + 30.0, true[2].row - 25.0, CONTACT_PX, RADIUS_PX), *true[3:]]
    presses = [
        (press(ball, near=False, seed=number), [label])
        for number, (ball, label) in enumerate(zip(true, labels, strict=True))
    ]
    found = fit_inverse_map(gather_samples(presses), labels, SHAPE, max_samples=12_000)
    assert found.kept.tolist() == [number != 2 for number in range(6)]


def test_a_saturated_pixel_keeps_an_estimate_but_less_weight() -> None:
    found = fitted(near=False).map
    image = press(balls()[0], near=False)
    image.clipped[100:110, 100:110] = True
    gradients = found.gradients(image)
    assert gradients.valid[105, 105]
    assert 0.0 < gradients.weight[105, 105] < 0.5 * gradients.weight[50, 150]


def test_a_colour_that_no_ball_showed_carries_less_weight_or_none() -> None:
    found = fitted(near=False).map
    image = press(balls()[0], near=False, noise=0.0)
    image.values[10, 10] = (9.0, 0.0, 9.0)
    gradients = found.gradients(image)
    assert gradients.weight[10, 10] < 0.05
    assert gradients.weight[10, 200] > 0.9


def test_another_size_is_refused() -> None:
    found = fitted(near=False).map
    small = NormalizedImage(np.ones((10, 12, 3), np.float32), np.ones((10, 12), bool), np.zeros((10, 12), bool))
    with pytest.raises(CalibrationMismatch, match="12x10 pixels but its calibration is for 320x240"):
        found.gradients(small)


def test_one_ball_fits_without_a_held_out_error() -> None:
    ball = balls()[5]
    found = fit_inverse_map(gather_samples([(press(ball, near=False), [ball])]), [ball], SHAPE)
    assert found.held_out_deg is None
    assert error_deg(found.map, ball, near=False) < 1.0


def test_balls_of_another_radius_are_read_by_a_map_that_never_saw_their_size() -> None:
    small = [replace(ball, radius_px=0.7 * RADIUS_PX, contact_radius_px=0.7 * CONTACT_PX) for ball in balls()[::2]]
    both = balls() + small
    presses = [(press(ball, near=False, seed=number), [ball]) for number, ball in enumerate(both)]
    fit = fit_inverse_map(gather_samples(presses), both, SHAPE, max_samples=12_000)
    assert fit.of_another_radius is not None
    assert [band.gain for band in fit.gains[1:]] == pytest.approx([1.0] * 3, abs=0.02)
    assert fitted(near=False).of_another_radius is None
    assert len(fitted(near=False).gains) == 4


def test_too_few_pixels_are_refused() -> None:
    ball = Ball(100.0, 100.0, 5.0, RADIUS_PX)
    with pytest.raises(CalibrationError, match="usable pixels"):
        fit_inverse_map(gather_samples([(press(ball, near=False), [ball])]), [ball], SHAPE)


def test_no_ball_is_refused() -> None:
    with pytest.raises(CalibrationError, match="no ball"):
        gather_samples([])


def test_the_map_survives_as_arrays() -> None:
    found = fitted(near=True).map
    again = InverseMap.from_arrays(found.arrays(), "model")
    image = press(balls()[2], near=True)
    np.testing.assert_array_equal(again.gradients(image).p, found.gradients(image).p)


def test_arrays_that_are_no_map_are_refused_by_name() -> None:
    arrays = fitted(near=False).map.arrays()
    with pytest.raises(RecordError, match="model\\.npz"):
        InverseMap.from_arrays({"shape": arrays["shape"]}, "model.npz")
    with pytest.raises(RecordError, match="coefficients of shape"):
        InverseMap.from_arrays(arrays | {"coefficients": arrays["coefficients"][1:]}, "model.npz")


def test_enlarged_samples_lie_where_their_pixels_lie() -> None:
    ball = Ball(10.0, 20.0, 4.0, 8.0)
    assert ball.enlarged(2.0) == Ball(20.5, 40.5, 8.0, 16.0)
    samples = BallSamples(
        np.ones((1, 3), np.float32), *(np.ones(1, np.float32) for _ in range(4)), np.zeros(1, np.intp)
    )
    assert samples.enlarged(2.0).column[0] == pytest.approx(2.5)
