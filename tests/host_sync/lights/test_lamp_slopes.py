"""Slopes that lamps tell, of intensities that they show."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from point_lamps import point_lamps

from device.inverse_map.model import InverseMap
from host_sync.lights.lamp_slopes import (
    INTENSITY_SIGMA,
    MAX_MOVE,
    ChannelTrust,
    KnownBefore,
    LampReader,
    LampSkin,
    bounded,
    gauss_newton_step,
    move_past_hidden,
    move_towards,
)

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
    tilt_gain=0.2,
)
RANDOM = np.random.default_rng(0)
COUNT = 200
COLUMN, ROW = RANDOM.uniform(40, 360, COUNT), RANDOM.uniform(30, 270, COUNT)
TRUE = RANDOM.uniform(-0.3, 0.3, (COUNT, 2))
Z_PX = RANDOM.uniform(0.0, 25.0, COUNT)
SKIN = LampSkin.at(MODEL, COLUMN, ROW)
SEEN = SKIN.shown(TRUE, Z_PX)
READ = 0.9 * TRUE + 0.01
APART, SETTING = (0.03, 0.08), (0.9, 0.6)
VISIBLE = RANDOM.uniform(0.0, 1.0, (COUNT, 3, 3))


def found(seen: np.ndarray, before: KnownBefore, steps: int = 6) -> np.ndarray:
    return move_towards(SKIN, seen, READ, Z_PX, before, steps)


def hiding(hidden: list[bool], counts: float = 1.0, free_steps: int = 0) -> ChannelTrust:
    """These channels hidden everywhere, perhaps, that count so much at most."""
    everywhere = np.array(np.broadcast_to(hidden, SEEN.shape))
    return ChannelTrust(everywhere, np.full(SEEN.shape, counts), APART, SETTING, free_steps)


def by_formulas(
    skin: LampSkin, seen: np.ndarray, before: KnownBefore, steps: int, trust: ChannelTrust
) -> tuple[np.ndarray, np.ndarray]:
    """The search by whole arrays, and how much channels counted in its last step."""
    slope, weight = READ, np.ones(seen.shape)
    for step in range(steps):
        shown, change = skin.shown_and_changes(slope, Z_PX)
        missing = seen - shown
        apart = np.clip((np.abs(missing) - APART[0]) / (APART[1] - APART[0]), 0.0, 1.0)
        setting = np.clip((SETTING[0] - shown) / (SETTING[0] - SETTING[1]), 0.0, 1.0)
        counted = np.minimum(trust.counts, ((1.0 - apart) * (1.0 - setting)) ** 2)
        weight = np.where(trust.hidden, 0.0 if step < trust.free_steps else counted, 1.0)
        own = np.einsum("ncc->nc", skin.shares)
        lost = (1.0 - weight) * np.maximum(-missing, 0.0)
        missing = missing + np.einsum("nck,nk->nc", skin.shares, lost / own) - lost
        move = gauss_newton_step(change, weight * INTENSITY_SIGMA**-2, missing, before.slope - slope, before.sigma)
        slope = slope + bounded(move)
    return slope, weight


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
    at_rest = move_towards(SKIN, SEEN, READ, 0.0 * Z_PX, before, 6)
    assert np.abs(at_rest - TRUE)[Z_PX > 15.0].max() > 0.01, "elevation counts"


def test_what_is_known_before_decides_as_far_as_it_is_sure() -> None:
    np.testing.assert_allclose(found(SEEN, KnownBefore(READ, 1e-4)), READ, atol=1e-3)


def test_two_channels_are_enough_where_the_third_is_dark() -> None:
    """Its own light is missing from the others too, as far as their filters pass it."""
    own = MODEL.own_light(TRUE[:, 0], TRUE[:, 1], COLUMN, ROW, Z_PX)
    own[:, 1] = 0.0
    dark = MODEL.mixed(own) / SKIN.rest + MODEL.bounced(TRUE[:, 0], TRUE[:, 1], SKIN.close)
    before, hidden = KnownBefore(READ, 0.15), [False, True, False]
    wrong = np.abs(found(dark, before, 12) - TRUE).mean()
    mended, weight = move_past_hidden(SKIN, dark, READ, Z_PX, before, 12, hiding(hidden, free_steps=12))
    assert wrong > 0.1
    assert np.abs(mended - TRUE).mean() < 0.01
    np.testing.assert_array_equal(weight, np.broadcast_to([1.0, 0.0, 1.0], weight.shape))


@pytest.mark.parametrize("off", [-0.2, -0.05, 0.0, 0.05])
def test_a_channel_that_may_be_hidden_counts_as_far_as_it_is_as_bright_as_predicted(off: float) -> None:
    shown, before = SKIN.shown(READ, Z_PX), KnownBefore(READ, 0.15)
    _, weight = move_past_hidden(
        SKIN, shown + np.array([off, 0.0, 0.01]), READ, Z_PX, before, 1, hiding([True, True, False], 0.9)
    )
    setting = np.clip((0.9 - shown[:, :2]) / 0.3, 0.0, 1.0)
    assert 0.05 < setting.mean() < 0.95, "some lights are about to set"
    wanted = np.ones(shown.shape)
    wanted[:, :2] = (1.0 - setting) ** 2
    wanted[:, 0] *= np.clip(1.0 - (abs(off) - 0.03) / 0.05, 0.0, 1.0) ** 2
    np.testing.assert_allclose(weight, np.minimum([0.9, 0.9, 1.0], wanted), atol=1e-9)


@pytest.mark.parametrize(("steps", "free_steps"), [(8, 3), (2, 0), (1, 1)])
def test_the_search_is_that_of_the_formulas(steps: int, free_steps: int) -> None:
    skin, before = replace(SKIN, visible=VISIBLE), KnownBefore(READ, 0.15)
    seen = skin.shown(TRUE, Z_PX) + RANDOM.normal(0.0, 0.03, SEEN.shape)
    trust = ChannelTrust(
        RANDOM.random(SEEN.shape) < 0.5, RANDOM.uniform(0.2, 1.0, SEEN.shape), APART, SETTING, free_steps
    )
    slope, weight = move_past_hidden(skin, seen, READ, Z_PX, before, steps, trust)
    wanted = by_formulas(skin, seen, before, steps, trust)
    np.testing.assert_allclose(slope, wanted[0], atol=1e-9)
    np.testing.assert_allclose(weight, wanted[1], atol=1e-9)


def test_no_step_is_longer_than_the_longest() -> None:
    far = found(3.0 * SEEN, KnownBefore(READ, 10.0), 1) - READ
    assert np.linalg.norm(far, axis=1).max() == pytest.approx(MAX_MOVE, rel=1e-9)
    np.testing.assert_array_equal(found(SEEN, KnownBefore(READ, 0.15), 0), READ)


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
