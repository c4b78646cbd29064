"""Elevation that light tells of skin under lamps that are known: recovered, unsure, and searched for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from point_lamps import point_lamps

from host_sync.lights.lamp_slopes import LampSkin
from host_sync.reconstruction.light_elevation import MAX_ROUNDS, MIN_CELLS, RiseSearch, rise_told_by_light

SHAPE = (240, 320)
MODEL = replace(
    point_lamps(SHAPE, np.array([[0.62, 0.0, 0.4], [-0.31, 0.54, 0.4], [-0.31, -0.54, 0.4]])),
    roughness=0.3,
)
COLUMN, ROW = (axis.ravel() for axis in np.meshgrid(np.arange(2.0, 320.0, 4.0), np.arange(2.0, 240.0, 4.0)))
SKIN = LampSkin.at(MODEL, COLUMN, ROW)
RNG = np.random.default_rng(0)
SLOPE = 0.05 * RNG.standard_normal((len(ROW), 2))


def seen(z_px: float, noise: float = 0.001) -> np.ndarray:
    shown = SKIN.shown(SLOPE, np.full(len(ROW), z_px))
    return shown + noise * np.random.default_rng(1).standard_normal(shown.shape)


@pytest.mark.parametrize("z_px", [-3.0, 0.0, 5.0])
def test_the_light_tells_how_high_skin_stands(z_px: float) -> None:
    rise = rise_told_by_light(SKIN, seen(z_px), SLOPE, np.zeros(len(ROW)))
    assert rise is not None
    assert rise.z_px == pytest.approx(z_px, abs=0.1 + 0.05 * abs(z_px))
    assert 0.0 < rise.sigma_px < 0.3


def test_brighter_lamps_and_dust_are_no_elevation() -> None:
    light = seen(2.0) * [1.02, 0.99, 1.0]
    light[::40] *= 0.7
    rise = rise_told_by_light(SKIN, light, SLOPE, np.zeros(len(ROW)))
    assert rise is not None
    assert rise.z_px == pytest.approx(2.0, abs=0.5)
    np.testing.assert_allclose(rise.levels, np.log([1.02, 0.99, 1.0]), atol=2e-3)
    np.testing.assert_allclose(rise.drift, rise.levels, atol=1e-3)


def test_lamps_that_did_not_drift_are_left_as_they_are() -> None:
    rise = rise_told_by_light(SKIN, seen(2.0), SLOPE, np.zeros(len(ROW)))
    assert rise is not None
    np.testing.assert_array_equal(rise.drift, 0.0)


def test_deviations_hold_what_is_left_and_what_is_unsure() -> None:
    rise = rise_told_by_light(SKIN, seen(2.0, 0.01), SLOPE, np.zeros(len(ROW)))
    assert rise is not None
    variance = (rise.deviations()[:, 0] ** 2).sum()
    assert variance == pytest.approx(rise.z_px**2 + rise.sigma_px**2)


def test_the_uncertainty_is_that_of_the_noise() -> None:
    found = []
    for number in range(40):
        noise = 0.01 * np.random.default_rng(number).standard_normal((len(ROW), 3))
        rise = rise_told_by_light(SKIN, seen(1.0, 0.0) + noise, SLOPE, np.zeros(len(ROW)))
        assert rise is not None
        found.append((rise.z_px, rise.sigma_px))
    told, sigma = np.array(found).T
    assert np.sqrt(np.square(sigma).mean()) == pytest.approx(told.std(), rel=0.4)


def test_few_cells_tell_nothing() -> None:
    few = SKIN.select(np.arange(MIN_CELLS - 1))
    assert rise_told_by_light(few, seen(1.0)[: MIN_CELLS - 1], SLOPE[: MIN_CELLS - 1], np.zeros(MIN_CELLS - 1)) is None


@pytest.mark.parametrize("response", [-0.8, -1.4, -2.5])
def test_the_search_ends_at_the_elevation(response: float) -> None:
    search, left_px = RiseSearch(100.0), 8.0
    while search.goes_on(left_px):
        left_px = response * (search.z_px - 8.0)
    assert search.z_px == pytest.approx(8.0, abs=0.1)


def test_the_search_stays_in_bounds_and_ends() -> None:
    search, rounds = RiseSearch(5.0), 1
    while search.goes_on(50.0):
        rounds += 1
        assert abs(search.z_px) <= 5.0
    assert rounds == MAX_ROUNDS
