"""Slopes that lamps tell, of intensities that they show."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from point_lamps import point_lamps

from device.inverse_map.model import InverseMap
from host_sync.lights.lamp_slopes import KnownBefore, LampReader, LampSkin, gauss_newton_step, move_towards

SHAPE = (300, 400)
MODEL = replace(
    point_lamps(SHAPE),
    strip=0.3,
    mixing=np.array([[1.0, 0.1, 0.08], [0.12, 1.0, 0.1], [0.1, 0.1, 1.0]]),
    haze=np.full(3, 0.01),
    roughness=0.4,
    gloss=0.1,
    gloss_width=0.4,
    bounce_close=0.2,
    bounce_afar=0.1,
    beam=0.5,
    camera=0.1,
)
RANDOM = np.random.default_rng(0)
COUNT = 200
COLUMN, ROW = RANDOM.uniform(40, 360, COUNT), RANDOM.uniform(30, 270, COUNT)
TRUE = RANDOM.uniform(-0.3, 0.3, (COUNT, 2))
Z_PX = RANDOM.uniform(0.0, 25.0, COUNT)
SKIN = LampSkin.at(MODEL, COLUMN, ROW)
SEEN = SKIN.shown(TRUE, Z_PX)
READ = 0.9 * TRUE + 0.01


def found(seen: np.ndarray, before: KnownBefore, steps: int = 6, trust: np.ndarray | None = None) -> np.ndarray:
    slope = READ
    for _ in range(steps):
        slope = move_towards(SKIN, seen, slope, Z_PX, before, trust)
    return slope


def test_skin_shows_what_the_model_says() -> None:
    wanted = MODEL.shown(TRUE[:, 0], TRUE[:, 1], COLUMN, ROW, Z_PX)
    np.testing.assert_allclose(SEEN, wanted, rtol=1e-12)
    some = np.arange(0, COUNT, 7)
    np.testing.assert_allclose(SKIN.select(some).shown(TRUE[some], Z_PX[some]), wanted[some], rtol=1e-12)


def test_no_place_shows_nothing() -> None:
    none = np.zeros(0)
    skin = LampSkin.at(MODEL, none, none)
    shown, changes = skin.shown_and_changes(np.zeros((0, 2)), none)
    assert shown.shape == (0, 3)
    assert changes.shape == (0, 3, 2)
    assert skin.shown(np.zeros((0, 2)), none, MODEL).shape == (0, 3)


def test_changes_are_those_of_what_is_shown() -> None:
    shown, changes = SKIN.shown_and_changes(TRUE, Z_PX)
    np.testing.assert_array_equal(shown, SKIN.shown(TRUE, Z_PX))
    for axis in (0, 1):
        beside = SKIN.shown(TRUE + 1e-3 * np.eye(2)[axis], Z_PX)
        np.testing.assert_allclose(changes[..., axis], (beside - shown) / 1e-3, rtol=1e-9)


def test_slopes_are_found_at_any_elevation() -> None:
    before = KnownBefore(READ, 10.0)
    np.testing.assert_allclose(found(SEEN, before), TRUE, atol=1e-4)
    at_rest = READ
    for _ in range(6):
        at_rest = move_towards(SKIN, SEEN, at_rest, 0.0 * Z_PX, before)
    assert np.abs(at_rest - TRUE)[Z_PX > 15.0].max() > 0.01, "elevation counts"


def test_what_is_known_before_decides_as_far_as_it_is_sure() -> None:
    np.testing.assert_allclose(found(SEEN, KnownBefore(READ, 1e-4)), READ, atol=1e-3)


def test_two_channels_are_enough_where_the_third_is_dark() -> None:
    """Its own light is missing from the others too, as far as their filters pass it."""
    own = MODEL.own_light(TRUE[:, 0], TRUE[:, 1], COLUMN, ROW, Z_PX)
    own[:, 1] = 0.0
    dark = MODEL.mixed(own) / SKIN.rest + MODEL.bounced(TRUE[:, 0], TRUE[:, 1], SKIN.close)
    trust = np.broadcast_to([1.0, 0.0, 1.0], SEEN.shape)
    before = KnownBefore(READ, 0.15)
    wrong = np.abs(found(dark, before, 12) - TRUE).mean()
    mended = np.abs(found(dark, before, 12, trust) - TRUE).mean()
    assert wrong > 0.1
    assert mended < 0.01


def test_a_step_is_that_of_least_squares() -> None:
    change, weight = RANDOM.normal(size=(5, 3, 2)), RANDOM.uniform(1.0, 9.0, (5, 3))
    missing, back, sigma = RANDOM.normal(size=(5, 3)), RANDOM.normal(size=(5, 2)), 0.4
    moved = gauss_newton_step(change, weight, missing, back, sigma)
    for one in range(5):
        root = np.sqrt(weight[one])
        rows = np.concatenate([root[:, None] * change[one], np.eye(2) / sigma])
        wanted = np.linalg.lstsq(rows, np.concatenate([root * missing[one], back[one] / sigma]), rcond=None)[0]
        np.testing.assert_allclose(moved[one], wanted, rtol=1e-9)


def test_a_reader_mends_what_a_map_reads_too_flat() -> None:
    shown = SKIN.shown(TRUE, 0.0 * Z_PX).astype(np.float32)
    flat = cast(InverseMap, SimpleNamespace(predict=lambda *_: READ))
    read = LampReader(flat, MODEL).predict(shown, COLUMN.astype(np.float32), ROW.astype(np.float32))
    np.testing.assert_allclose(read, TRUE, atol=2e-3)
    assert np.abs(READ - TRUE).max() == pytest.approx(0.04, abs=0.01)


def test_lamps_of_no_haze_lose_nothing_to_each_other_without_mixing() -> None:
    alone = LampSkin.at(replace(MODEL, mixing=np.eye(3)), COLUMN, ROW)
    np.testing.assert_allclose(alone.without(np.ones((COUNT, 3))), 0.0, atol=1e-12)
