"""Lamps that balls show, and what they say of elevation: frames come from a renderer of their own."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from near_lamps import LAMPS_OUT_PX, SHAPE, NearLamps, balls, press_px
from point_lamps import point_lamps

from device.balls.sphere import Ball, gather_samples, pixels_inside
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from host_sync.calibration.elevated_balls import ElevatedBalls
from host_sync.calibration.elevation_response import ElevationResponse, measure_elevation_response
from host_sync.calibration.lamp_elevation import as_read, find_lamps, response_under
from host_sync.lights import lamp_fit
from host_sync.lights.lamp_fit import FOLDS, LampFit, fit_lamps
from host_sync.lights.lamp_model import FittedLamps, LampModel
from host_sync.lights.surroundings import Surroundings

HEIGHT_PX = 220.0
LAMPS = NearLamps(HEIGHT_PX)
TRUE = balls()
IMAGES = [LAMPS.intensity(press_px(ball, apex), noise=0.005, seed=i) for i, (ball, apex) in enumerate(TRUE)]
OFF_PX = np.random.default_rng(3).uniform(-1.0, 1.0, (len(TRUE), 2))


def presses(images: list[NormalizedImage]) -> list[tuple[NormalizedImage, list[Ball]]]:
    """With centres that are off by up to a pixel."""
    moved = [
        replace(ball, column=ball.column + off[0], row=ball.row + off[1], contact_radius_px=24.0)
        for (ball, _), off in zip(TRUE, OFF_PX.tolist(), strict=True)
    ]
    return [(image, [ball]) for image, ball in zip(images, moved, strict=True)]


def elevated(pressed: list[tuple[NormalizedImage, list[Ball]]], flat_field: np.ndarray) -> ElevatedBalls:
    apexes_px = [apex for _, apex in TRUE]
    shown = [(image, ball, apex) for (image, (ball,)), apex in zip(pressed, apexes_px, strict=True)]
    response = measure_elevation_response(shown, flat_field)
    assert response is not None
    return ElevatedBalls(
        response, tuple(tuple(of_press) for _, of_press in pressed), tuple((apex,) for apex in apexes_px)
    )


def fitted(images: list[NormalizedImage]) -> LampFit:
    pressed = presses(images)
    samples = gather_samples(pressed, to_teach=True)
    close = np.ones((len(samples.p), 3))
    for number, (image, _) in enumerate(pressed):
        rows = samples.ball == number
        close[rows] = Surroundings.of(image).at(samples.column[rows], samples.row[rows])
    return fit_lamps(samples, close, [ball for _, (ball,) in pressed], [apex for _, apex in TRUE], SHAPE)


FIT = fitted(IMAGES)


def test_balls_show_where_the_lamps_stand_and_where_their_centres_are() -> None:
    position = SHAPE[1] * FIT.lamps.model.position
    np.testing.assert_allclose(position[:, 2], HEIGHT_PX, rtol=0.05)
    np.testing.assert_allclose(np.hypot(*position[:, :2].T), LAMPS_OUT_PX, rtol=0.05)
    angle = np.degrees(np.arctan2(position[:, 1], position[:, 0])) % 360.0
    np.testing.assert_allclose(angle, [10.0, 130.0, 250.0], atol=2.0)
    left = OFF_PX + FIT.shift_px
    assert float(np.sqrt((left**2).mean())) < 0.35 * float(np.sqrt((OFF_PX**2).mean()))
    assert FIT.residual < 0.006
    assert FIT.explains(residual=0.03)


def test_light_of_level_skin_beside_a_ball_is_told_from_lamps() -> None:
    """A plane that slants by t sees a level one over (1 - cos t) / 2 of what is above it; the skin sends back 0.6."""
    albedo = 0.6
    images = []
    for image, (ball, apex) in zip(IMAGES, TRUE, strict=True):
        q, p = np.gradient(press_px(ball, apex))
        view = 0.5 * (1.0 - 1.0 / np.sqrt(1.0 + p**2 + q**2))
        images.append(replace(image, values=image.values + (albedo * view[..., None]).astype(np.float32)))
    fit = fitted(images)
    bounce = fit.lamps.model.bounce_close + fit.lamps.model.bounce_afar
    assert bounce == pytest.approx(0.5 * albedo, abs=0.07)
    assert FIT.lamps.model.bounce_close + FIT.lamps.model.bounce_afar == pytest.approx(0.0, abs=0.07)
    assert fit.residual < 0.006
    np.testing.assert_allclose(SHAPE[1] * fit.lamps.model.position[:, 2], HEIGHT_PX, rtol=0.05)


def test_without_a_fold_of_balls_lamps_stand_a_little_elsewhere() -> None:
    all_balls = FIT.lamps.model.position
    folds = np.stack([model.position for model in FIT.lamps.folds])
    assert len(folds) == FOLDS
    moved = np.abs(folds - all_balls).max(axis=(1, 2))
    assert (moved > 0.0).all()
    assert (moved < 0.1).all()


def test_what_polynomials_say_as_well_or_falls_off_strangely_is_not_lamps() -> None:
    assert not FIT.explains(residual=FIT.residual)
    assert not replace(FIT, residual=0.05).explains(residual=1.0)
    strange = FittedLamps(replace(FIT.lamps.model, fall_off=9.5), FIT.lamps.folds)
    assert not replace(FIT, lamps=strange).explains(residual=0.03)


def test_lowered_contacts_look_as_their_slopes_do_at_rest() -> None:
    pressed = presses(IMAGES)
    found = find_lamps(pressed, elevated(pressed, LAMPS.flat_field()))
    assert found is not None
    assert found.followed(0.0, is_matt=False) is found
    before, after = [], []
    for number, (image, (ball, apex)) in enumerate(zip(IMAGES, TRUE, strict=True)):
        row, column = pixels_inside(replace(ball, contact_radius_px=20.0), SHAPE)
        skin = press_px(ball, apex)
        q, p = np.gradient(skin)
        rest = LAMPS.light(skin, p, q, seen_at=0.0) / LAMPS.flat_field()
        before.append((image.values - rest)[row, column])
        after.append((found.lowered(number, image).values - rest)[row, column])
    wrong, left = (float(np.sqrt((np.concatenate(part) ** 2).mean())) for part in (before, after))
    assert wrong > 0.03
    assert left < 0.3 * wrong


def test_light_that_knows_no_elevation_has_no_lamps() -> None:
    images = [
        LAMPS.intensity(press_px(ball, apex), seen_at=0.0, noise=0.002, seed=i) for i, (ball, apex) in enumerate(TRUE)
    ]
    pressed = [(image, [ball]) for image, (ball, _) in zip(images, TRUE, strict=True)]
    assert find_lamps(pressed, elevated(pressed, LAMPS.flat_field())) is None


def test_light_of_no_lamp_is_not_explained() -> None:
    """Each channel's slant turns over the field as no lamp's does."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[1]
    images = []
    for ball, apex in TRUE:
        q, p = np.gradient(press_px(ball, apex))
        planes = [
            1.0 + p * np.cos(angle + 9.0 * column) + q * np.sin(angle + 7.0 * row) - 0.8 * (p * p + 0.5 * q * q)
            for angle in np.radians([0.0, 120.0, 240.0])
        ]
        valid = np.ones(SHAPE, bool)
        images.append(NormalizedImage(np.stack(planes, axis=-1).astype(np.float32), valid, ~valid))
    pressed = presses(images)
    shown = elevated(presses(IMAGES), LAMPS.flat_field())
    assert find_lamps(pressed, shown) is None


def points() -> LampModel:
    """The lamps of the renderer."""
    angle = np.radians([10.0, 130.0, 250.0])
    out = LAMPS_OUT_PX / SHAPE[1]
    position = np.stack([out * np.cos(angle), out * np.sin(angle), np.full(3, HEIGHT_PX / SHAPE[1])], axis=-1)
    return point_lamps(SHAPE, position)


def test_lamps_of_one_height_slant_more_by_one_over_it() -> None:
    response = response_under(points(), residual=0.004)
    assert response.nearness_per_px * HEIGHT_PX == pytest.approx(1.0, abs=0.05)
    assert response.relative_sigma == pytest.approx(0.02)
    assert response_under(points(), residual=0.03).relative_sigma == pytest.approx(0.1)
    assert response.nearness_sigma_per_px < 0.25 * response.nearness_per_px


def test_what_a_map_reads_of_raised_skin_is_taken_from_that_map() -> None:
    """One that is right on untouched skin, and half as steep again as brightness says: shares are its own."""
    model = points()

    def predict(shown: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        x, y = (place - 0.5 * (size - 1) for place, size in ((column, SHAPE[1]), (row, SHAPE[0])))
        across = SHAPE[1] * model.position[:, :2] - np.stack([x, y], axis=-1)[:, None]
        slants = -across / (SHAPE[1] * model.position[:, 2])[:, None]
        system = np.concatenate([slants, -shown[..., None]], axis=-1)
        found = np.linalg.solve(system, -np.ones((len(x), 3, 1)))[..., 0]
        return found[:, :2]

    level = ElevationResponse(
        np.zeros((33, 33, 2, 3), np.float32),
        np.zeros((33, 33, 3), np.float32),
        np.zeros((33, 33, 2, 3), np.float32),
        1,
        0,
    )
    apexes = tuple((16.0,) for _ in TRUE)
    quiet = SimpleNamespace(predict=predict)
    inverse = cast(InverseMap, SimpleNamespace(quiet=quiet, max_trained_slope=0.6))
    known = ElevatedBalls(level, tuple((ball,) for ball, _ in TRUE), apexes, FittedLamps(model, ()))
    terms = as_read(known, inverse).response.as_slopes
    assert terms.shape == (33, 33, 9)
    p, q, z_px = 0.2, -0.1, 16.0
    middle = np.array([0.5 * (SHAPE[1] - 1)]), np.array([0.5 * (SHAPE[0] - 1)])
    slope = np.array([p]), np.array([q])
    seen = predict(model.shown(*slope, *middle, np.array([z_px])), *middle)[0]
    factors = terms[16, 16].astype(float)
    brighter = factors[0] + factors[1] * seen[0] + factors[2] * seen[1]
    wrong = [
        z_px * (factors[k] + factors[k + 1] * seen[0] + factors[k + 2] * seen[1] - brighter * s)
        for k, s in zip((3, 6), seen, strict=True)
    ]
    np.testing.assert_allclose(seen - wrong, [p, q], atol=0.004)
    assert abs(seen[0] - p) > 0.01, "raised skin is read too steep"
    unknown = replace(known, lamps=None)
    assert as_read(unknown, inverse) is unknown


@pytest.mark.slow
@pytest.mark.parametrize("begins", [(0, 1), (1, 0)])
def test_of_two_searches_the_one_counts_that_explains_the_balls_better(
    begins: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search may end at lamps much too long: one of them is made to begin there."""
    far_off, close = (0.5, 6.0), (0.35, 0.45)
    monkeypatch.setattr(lamp_fit, "STARTS", (far_off,))
    assert fitted(IMAGES).residual > 1.5 * FIT.residual
    monkeypatch.setattr(lamp_fit, "STARTS", tuple((far_off, close)[number] for number in begins))
    again = fitted(IMAGES)
    assert again.residual == pytest.approx(FIT.residual, rel=0.05)
    np.testing.assert_allclose(again.lamps.model.position, FIT.lamps.model.position, rtol=0.02, atol=0.005)


@pytest.mark.slow
def test_the_sign_of_a_strip_from_which_a_search_begins_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lamp_fit, "MAX_RESIDUAL", 0.0)  # the first search alone
    # Points show little of a strip's length: searches have to go on for as long as they gain anything.
    monkeypatch.setattr(lamp_fit, "TOLERANCE", 1e-8)
    monkeypatch.setattr(lamp_fit, "ROUNDS", 200)
    found = []
    for strip in (0.45, -0.45):
        monkeypatch.setattr(lamp_fit, "STARTS", ((0.35, strip),))
        found.append(fitted(IMAGES).lamps.model)
    assert found[0].strip == pytest.approx(-found[1].strip, abs=1e-3)
    np.testing.assert_allclose(found[0].position, found[1].position, atol=1e-4)


def test_what_is_expected_of_lamps_beforehand_moves_them_little_beside_quiet_balls() -> None:
    """Strips are expected 0.2 widths long, these lamps are points: a search that expects 0.03 to be left puts them too
    low by 0.3 %.
    """
    heights = FIT.lamps.model.position[:, 2]
    assert heights.mean() * SHAPE[1] == pytest.approx(HEIGHT_PX, rel=0.0015)
