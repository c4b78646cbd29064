"""Balls under near lamps: where they stand, and how they would look at the elevation of untouched skin."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from near_lamps import SHAPE, NearLamps, balls, press_px

from device.balls.sphere import Ball, pixels_inside, sphere_slopes
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from host_sync.calibration.elevated_balls import ElevatedBalls, find_elevated_balls
from host_sync.calibration.elevation_response import LAMPS_DOUBT

LAMPS = NearLamps(220.0)
TRUE = balls()


def map_that_reads_presses(offset: float = 0.0) -> InverseMap:
    """What reads the slopes of the press whose first pixel it recognises, all of them too large by an offset."""

    def on_grid(values: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        column, row = column.astype(int), row.astype(int)
        (z,) = (
            z
            for image, z in zip(IMAGES, SKINS, strict=True)
            if np.array_equal(values, image.values[np.ix_(row, column)])
        )
        q, p = np.gradient(z)
        here = np.ix_(row, column)
        return (np.stack([p[here], q[here]], axis=-1) + offset).astype(np.float32)

    return cast(InverseMap, SimpleNamespace(shape=SHAPE, on_grid=on_grid))


SKINS = [press_px(ball, apex) for ball, apex in TRUE]
IMAGES = [LAMPS.intensity(z, noise=0.005, seed=i) for i, z in enumerate(SKINS)]


def found(lamps: NearLamps = LAMPS, shift_px: float = 3.0) -> ElevatedBalls:
    """From centres that are off by as much as an apex that is brighter than 1 puts them."""
    moved = [replace(ball, column=ball.column + shift_px * (0.5 - ball.column / SHAPE[1])) for ball, _ in TRUE]
    presses: list[tuple[NormalizedImage, list[Ball]]] = [(im, [b]) for im, b in zip(IMAGES, moved, strict=True)]
    elevated = find_elevated_balls(presses, map_that_reads_presses(), lamps.flat_field())
    assert elevated is not None
    return elevated


def test_centres_and_apexes_are_those_of_the_skin() -> None:
    elevated = found()
    assert elevated.response.is_certain
    for (true, apex), (ball,), (apex_px,) in zip(TRUE, elevated.balls, elevated.apexes_px, strict=True):
        assert np.hypot(ball.column - true.column, ball.row - true.row) < 0.012 * true.radius_px
        assert abs(apex_px - apex) < 0.06 * apex
    assert 13.0 < elevated.left.apex_px < 19.0
    assert elevated.left.nearness_per_px == elevated.response.nearness_sigma_per_px


def test_lowered_contacts_look_as_their_slopes_do_at_rest() -> None:
    elevated = found()
    before, after = [], []
    for number, image in enumerate(IMAGES):
        (ball,) = elevated.balls[number]
        inner = replace(ball, contact_radius_px=0.75 * ball.contact_radius_px)
        row, column = pixels_inside(inner, SHAPE)
        q, p = np.gradient(SKINS[number])
        rest = LAMPS.light(SKINS[number], p, q, seen_at=0.0) / LAMPS.flat_field()
        lowered = elevated.lowered(number, image)
        before.append((image.values - rest)[row, column])
        after.append((lowered.values - rest)[row, column])
        outside = np.ones(SHAPE, bool)
        outside[pixels_inside(ball, SHAPE)] = False
        np.testing.assert_array_equal(lowered.values[outside], image.values[outside])
    wrong, left = (float(np.sqrt((np.concatenate(part) ** 2).mean())) for part in (before, after))
    assert wrong > 0.03
    assert left < 0.35 * wrong


def test_slopes_of_spheres_are_those_that_teach() -> None:
    (ball, apex), z = TRUE[5], SKINS[5]
    row, column = pixels_inside(replace(ball, contact_radius_px=15.0), SHAPE)
    p, _ = sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32))
    np.testing.assert_allclose(np.gradient(z)[1][row, column], p, atol=0.01)
    assert abs(z.max() - apex) < 0.1


def test_too_few_balls_say_nothing() -> None:
    presses: list[tuple[NormalizedImage, list[Ball]]] = [(IMAGES[0], [TRUE[0][0]])]
    assert find_elevated_balls(presses, map_that_reads_presses(), LAMPS.flat_field()) is None


def test_a_skin_that_is_not_matt_is_followed_by_the_height_of_its_lamps() -> None:
    elevated = found()
    seen = replace(elevated.response, share=0.2, share_sigma=0.01)
    assert not seen.is_certain
    followed = replace(elevated, response=seen).followed(1.0 / 220.0, is_matt=True)
    assert followed is not None
    assert followed.response.is_of_lamps
    assert followed.response.nearness_per_px * 220.0 == pytest.approx(1.0, abs=1e-3)
    assert followed.left.nearness_per_px * 220.0 == pytest.approx(LAMPS_DOUBT, abs=1e-3)
    matt = elevated.response.slanting
    off = float(np.abs(followed.response.slanting - matt).mean() / np.abs(matt).mean())
    assert off < 0.2, "under these lamps a matt skin shows just that"


@pytest.mark.parametrize(("share", "share_sigma"), [(0.05, 0.001), (0.2, 0.05), (6.8, 1.7)])
def test_what_is_not_clearly_elevation_is_not_followed(share: float, share_sigma: float) -> None:
    elevated = found()
    unclear = replace(elevated, response=replace(elevated.response, share=share, share_sigma=share_sigma))
    assert unclear.followed(1.0 / 220.0, is_matt=True) is None
    assert elevated.followed(1.0 / 220.0, is_matt=True) is elevated
    glitters = elevated.followed(1.0 / 220.0, is_matt=False)
    assert glitters is not None
    assert glitters.response.is_of_lamps
