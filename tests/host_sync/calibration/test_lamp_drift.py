"""Lamps that shine otherwise than in the calibration, told by untouched skin beside an object."""

from __future__ import annotations

import numpy as np
import pytest

from device.imaging.flat_field import NormalizedImage
from host_sync.calibration.lamp_drift import (
    PressLevels,
    believed_share,
    by_block,
    is_tilt,
    take_drift_out,
    untouched_level,
)
from host_sync.frame_checks.light_levels import SlopeResponse
from tests.apparatus.drifting_lamps import ANSWER, DRIFT, MAP, frame

RESPONSE = SlopeResponse(np.stack([ANSWER, 0.0 * ANSWER, 0.0 * ANSWER]), 0.01, 0.05)


def levels_of(*drifts: np.ndarray) -> PressLevels | None:
    return PressLevels.of((frame(drift, seed + 1) for seed, drift in enumerate(drifts)), MAP)


CALM = levels_of(*(np.zeros(3),) * 6)


def test_untouched_skin_tells_levels_to_a_few_parts_in_ten_thousand() -> None:
    for drift in (np.zeros(3), DRIFT, 2.0 * DRIFT):
        found = untouched_level(frame(drift), MAP)
        assert found is not None
        np.testing.assert_allclose(found.logs, drift, atol=5e-4)
        assert np.sqrt(np.diag(found.covariance)).max() < 1e-3


@pytest.mark.parametrize("dome", [0.0, 1.0])
def test_drift_is_taken_out(dome: float) -> None:
    image, steady = frame(DRIFT, dome=dome), frame(np.zeros(3), dome=dome)
    take_drift_out(image, MAP, CALM, RESPONSE)
    np.testing.assert_allclose(image.values / steady.values, 1.0, atol=8e-4)


def test_a_frame_without_drift_is_left_as_it_is() -> None:
    for seed in range(20, 30):
        image, steady = frame(np.zeros(3), seed), frame(np.zeros(3), seed)
        take_drift_out(image, MAP, CALM, RESPONSE)
        np.testing.assert_array_equal(image.values, steady.values)


def test_what_the_calibrations_own_presses_show_is_no_drift() -> None:
    """On some sensors a press brightens all skin: the map was taught so."""
    brighter = levels_of(*(np.full(3, 0.04),) * 6)
    restless = levels_of(*(scale * DRIFT for scale in (-1.0, -0.5, 0.0, 0.4, 0.8, 1.3)))
    for levels, drift in ((brighter, np.full(3, 0.04)), (restless, DRIFT)):
        image = frame(drift)
        take_drift_out(image, MAP, levels, RESPONSE)
        np.testing.assert_array_equal(image.values, frame(drift).values)


def test_few_presses_that_differ_do_not_make_a_drift_of_one_more() -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        levels = 0.01 * rng.standard_normal((7, 3))
        presses = PressLevels(
            tuple(levels[:6].mean(axis=0)), float(np.sqrt(levels[:6].var(axis=0, ddof=1).mean() * 7 / 6))
        )
        off = levels[6] - presses.mean
        assert np.abs(off * believed_share(off, presses.sigma**2 * np.eye(3))).max() < 0.02


def test_what_is_taken_out_is_reported_and_a_broken_lamp_is_left_to_be_refused() -> None:
    assert take_drift_out(frame(DRIFT), MAP, CALM, RESPONSE) == pytest.approx(np.expm1(0.02), abs=1e-3)
    assert take_drift_out(frame(np.zeros(3), 40), MAP, CALM, RESPONSE) == 0.0
    assert take_drift_out(frame(np.array([-0.3, 0.0, 0.0])), MAP, CALM, RESPONSE) == 0.0


def test_the_uncertainty_of_a_level_is_its_scatter() -> None:
    found = [untouched_level(frame(np.zeros(3), seed), MAP) for seed in range(60, 80)]
    levels = np.array([one.logs for one in found if one is not None])
    sigma = np.sqrt(np.mean([np.diag(one.covariance) for one in found if one is not None]))
    assert levels.std() < 1.5 * sigma
    assert levels.std() > 0.15 * sigma


@pytest.mark.parametrize("shape", [(4, 960), (960, 4), (8, 8), (2, 2)])
def test_a_field_of_a_few_rows_tells_nothing(shape: tuple[int, int]) -> None:
    everywhere = np.ones(shape, np.bool_)
    image = NormalizedImage(np.ones((*shape, 3), np.float32), everywhere, ~everywhere)
    assert take_drift_out(image, MAP, CALM, RESPONSE) == 0.0


def test_where_presses_or_frame_show_no_untouched_skin_nothing_is_done() -> None:
    assert levels_of(*(np.zeros(3),) * 3) is None
    blind = [frame(DRIFT, clipped=True) for _ in range(6)]
    assert PressLevels.of(blind, MAP) is None
    for image, levels, response in (
        (frame(DRIFT), None, RESPONSE),
        (frame(DRIFT), CALM, None),
        (blind[0], CALM, RESPONSE),
    ):
        take_drift_out(image, MAP, levels, response)
        np.testing.assert_array_equal(image.values, frame(DRIFT).values)


def test_a_plate_that_lies_tilted_under_the_whole_field_is_no_drift() -> None:
    tilted = np.array([0.004, -0.008]) @ ANSWER
    for levels, kept in ((tilted, True), (tilted + 0.01, False)):
        image = frame(levels, dome=0.0)
        take_drift_out(image, MAP, CALM, RESPONSE)
        assert np.array_equal(image.values, frame(levels, dome=0.0).values) == kept


@pytest.mark.parametrize("where", ["everywhere", "right"])
def test_a_tilted_plate_is_told_where_light_answers_to_slope_otherwise_at_each_place(where: str) -> None:
    rng = np.random.default_rng(8)
    skin = np.ones((96, 128), np.bool_)
    skin[:, : 0 if where == "everywhere" else -16] = False
    uneven = SlopeResponse(np.stack([ANSWER, *(0.4 * rng.standard_normal((2, 2, 3)))]), 0.01, 0.05)
    answers = by_block(uneven.at(skin.shape).reshape(*skin.shape, 6).astype(np.float32), skin).reshape(-1, 2, 3)
    for _ in range(20):
        tilt = 0.02 * rng.standard_normal(2)
        assert is_tilt(tilt @ answers, uneven, skin)
    assert not is_tilt(np.repeat(DRIFT[None], len(answers), axis=0), uneven, skin)


def test_whether_skin_is_tilted_is_asked_where_it_is() -> None:
    """The light answers to slope otherwise on the right, where alone the skin seems untouched."""
    across = np.array([[0.6, 0.5, 0.3], [-0.2, 0.3, 0.5]])
    response = SlopeResponse(np.stack([ANSWER, across, 0.0 * ANSWER]), 0.01, 0.05)
    right = np.zeros((96, 128), np.bool_)
    right[:, -16:] = True
    sloping = np.repeat([np.array([0.02, -0.03]) @ (ANSWER + across)], 6, axis=0)
    assert is_tilt(sloping, response, right)
    assert not is_tilt(sloping, response, np.fliplr(right))
