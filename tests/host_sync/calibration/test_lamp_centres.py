"""Centres of balls under lamps whose places are known: frames of matt spheres drawn ray by ray."""

import numpy as np
import pytest

from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage
from host_sync.calibration.lamp_centres import centres_under_lamps
from host_sync.lights.known_lamps import KnownLamps

SHAPE = (360, 480)
LAMPS = KnownLamps(np.array([(0.0, -520.0, 300.0), (-450.0, 260.0, 300.0), (450.0, 260.0, 300.0)]))
RADIUS_PX, CONTACT_PX, APEX_PX = 100.0, 55.0, 40.0
PLACES = ((120.0, 100.0), (240.0, 180.0), (360.0, 270.0))


def irradiance(z_px: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    here = np.stack([column - 0.5 * (SHAPE[1] - 1), row - 0.5 * (SHAPE[0] - 1), z_px], axis=-1)
    ray = LAMPS.position_px[:, None, None, :] - here
    facing = ray[..., 2] - p * ray[..., 0] - q * ray[..., 1]
    lit = facing / (np.sqrt(1.0 + p**2 + q**2) * np.linalg.norm(ray, axis=-1) ** 3)
    return np.moveaxis(lit, 0, -1)


def pressed(place: tuple[float, float], raised_px: float) -> NormalizedImage:
    """A sphere at a place; level skin beside it stands where its apex would with `raised_px` of 0."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    across, down = column - place[0], row - place[1]
    inside = across**2 + down**2 < CONTACT_PX**2
    height = np.sqrt(RADIUS_PX**2 - np.where(inside, across**2 + down**2, 0.0))
    level = np.zeros(SHAPE)
    z_px = np.where(inside, raised_px - RADIUS_PX + height, 0.0)
    p, q = (np.where(inside, -way / height, 0.0) for way in (across, down))
    values = irradiance(z_px, p, q) / irradiance(level, level, level)
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def looks_level_at(image: NormalizedImage, near: tuple[float, float]) -> tuple[float, float]:
    """Where intensity is alike in all channels: two straight lines cross there."""
    row, column = np.mgrid[round(near[1]) - 12 : round(near[1]) + 13, round(near[0]) - 12 : round(near[0]) + 13]
    seen = image.values[row, column].reshape(-1, 3).astype(float)
    terms = np.stack([np.ones(row.size), column.ravel(), row.ravel(), column.ravel() ** 2, row.ravel() ** 2], axis=1)
    differences = np.linalg.lstsq(terms[:, :3], seen[:, :2] - seen[:, 1:], rcond=None)[0]
    at = np.linalg.solve(differences[1:].T, -differences[0])
    return float(at[0]), float(at[1])


def test_apexes_that_seem_shifted_by_near_lamps_are_found_within_a_pixel() -> None:
    images = [pressed(place, APEX_PX) for place in PLACES]
    seeming = [looks_level_at(image, place) for image, place in zip(images, PLACES, strict=True)]
    presses = [(image, (Ball(*at, CONTACT_PX, RADIUS_PX),)) for image, at in zip(images, seeming, strict=True)]
    moved = centres_under_lamps(presses, [(APEX_PX,)] * len(presses), LAMPS)
    off = [np.hypot(at[0] - place[0], at[1] - place[1]) for at, place in zip(seeming, PLACES, strict=True)]
    left = [np.hypot(of[0].column - at[0], of[0].row - at[1]) for of, at in zip(moved, PLACES, strict=True)]
    assert max(off) > 2.0
    assert max(left) < 0.8


def test_a_coat_that_does_not_brighten_moves_nothing() -> None:
    ball = Ball(*PLACES[0], CONTACT_PX, RADIUS_PX)
    ((kept,),) = centres_under_lamps([(pressed(PLACES[0], 0.0), (ball,))], [(APEX_PX,)], LAMPS)
    assert np.hypot(kept.column - ball.column, kept.row - ball.row) < 0.3


def test_level_skin_raised_reads_alike_in_every_channel_at_the_slope_that_is_predicted() -> None:
    place = np.array([[60.0, 300.0]])
    slope, brighter = LAMPS.level_skin_raised(place, np.array([2.0]), SHAPE)
    raised, tilted = np.full(SHAPE, 2.0), np.zeros(SHAPE)
    seen = irradiance(raised, tilted - slope[0, 0], tilted - slope[0, 1])[300, 60]
    untouched = irradiance(tilted, tilted, tilted)[300, 60]
    assert seen / untouched - 1.0 == pytest.approx(brighter[0], abs=2e-4)
