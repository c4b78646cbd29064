"""Light of the surroundings in a scan: told by untouched skin whose reference light is uneven, and taken out."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from device.imaging.flat_field import NormalizedImage
from host_sync.calibration.lamp_drift import PressLevels
from host_sync.calibration.stray_light import (
    _lines,
    _lines_of_most_alike,
    find_stray_light,
    take_stray_light_out,
    with_stray_light,
)
from host_sync.frame_checks.light_levels import SlopeResponse
from tests.apparatus.drifting_lamps import ANSWER, COLUMN, DRIFT, MAP, SHAPE, frame

LIGHT = 0.15 + 0.6 * np.exp(-(((COLUMN[..., None] - np.array([0.0, 160.0, 320.0])) / 150.0) ** 2))
FLAT_FIELD = LIGHT.astype(np.float32)
RESPONSE = SlopeResponse(np.stack([ANSWER, 0.0 * ANSWER, 0.0 * ANSWER]), 0.01, 0.05)
CALM = PressLevels((0.0, 0.0, 0.0), 1e-4, 1e-4)
STRAY = np.array([0.010, 0.012, 0.008])
STEADY = np.zeros(3)


def hazy(stray: np.ndarray, drift: np.ndarray = STEADY, *, dome: float = 1.0) -> NormalizedImage:
    lit = frame(drift, dome=dome)
    return replace(lit, values=lit.values + (stray / LIGHT).astype(np.float32))


def taken_out(image: NormalizedImage, levels: PressLevels | None = CALM) -> float:
    return take_stray_light_out(image, FLAT_FIELD, MAP, levels, RESPONSE)


@pytest.mark.parametrize("dome", [0.0, 1.0])
@pytest.mark.parametrize("drift", [STEADY, DRIFT])
def test_stray_light_is_told_and_taken_out_and_drift_is_left(dome: float, drift: np.ndarray) -> None:
    found = find_stray_light(hazy(STRAY, drift, dome=dome), FLAT_FIELD, MAP)
    assert found is not None
    np.testing.assert_allclose(found.light, STRAY, atol=8e-4)
    image = hazy(STRAY, drift, dome=dome)
    assert taken_out(image) == pytest.approx(0.012, abs=8e-4)
    np.testing.assert_allclose(image.values / frame(drift, dome=dome).values, 1.0, atol=4e-3)


@pytest.mark.parametrize(
    "image",
    [
        frame(STEADY),
        frame(DRIFT),
        hazy(np.full(3, 3e-4)),
        hazy(-STRAY),
        hazy(30.0 * STRAY),
        frame(STEADY, clipped=True),
    ],
    ids=["steady", "drift", "hardly any", "a darker frame", "another light", "saturated"],
)
def test_other_frames_are_left_as_they_are(image: NormalizedImage) -> None:
    before = image.values.copy()
    assert taken_out(image) == 0.0
    np.testing.assert_array_equal(image.values, before)


@pytest.mark.parametrize("light", [0.5, 0.4])
def test_even_skin_tells_no_stray_light(light: float) -> None:
    even = np.full((*SHAPE, 3), light, np.float32)
    for image in (hazy(STRAY), frame(STEADY, dome=0.0)):
        found = find_stray_light(image, even, MAP)
        assert found is None or np.isfinite(found.believed(1e-4)).all()
        assert take_stray_light_out(image, even, MAP, CALM, RESPONSE) == 0.0


def test_what_a_slope_shows_as_well_is_no_stray_light() -> None:
    """Under lamps that fall off alike, stray light changes all places in one direction: here slopes along x do, too."""
    alike = np.repeat(FLAT_FIELD[..., 1:2], 3, axis=-1)
    lit = frame(STEADY)
    image = replace(lit, values=lit.values + (STRAY / alike).astype(np.float32))
    like_slopes = np.stack([STRAY / STRAY.max(), ANSWER[1]])
    as_tilt = SlopeResponse(np.stack([like_slopes, 0.0 * ANSWER, 0.0 * ANSWER]), 0.01, 0.05)
    assert take_stray_light_out(image, alike, MAP, CALM, as_tilt) == 0.0
    assert take_stray_light_out(image, alike, MAP, CALM, RESPONSE) > 0.0


def test_blocks_that_agree_tell_more_than_all_blocks() -> None:
    """Half of the field lies on an object that stands nearer to the lamps, most so where they give much light."""
    random = np.random.default_rng(0)
    each = random.uniform(1.5, 12.0, (60, 3))
    brightness = 1.0 + STRAY * each + 5e-4 * random.standard_normal((60, 3))
    brightness[:30] += random.uniform(0.02, 0.08, (30, 1)) * (2.0 / each[:30])
    level, light, _ = _lines_of_most_alike(each, brightness)
    np.testing.assert_allclose(light, STRAY, atol=3e-4)
    np.testing.assert_allclose(level, 0.0, atol=2e-3)
    assert np.abs(_lines(each, brightness)[1] - STRAY).max() > 3.0 * np.abs(light - STRAY).max()


def test_presses_tell_what_calm_frames_show_and_a_calibration_without_it_takes_nothing_out() -> None:
    presses = [frame(STEADY, seed) for seed in range(5)]
    levels = with_stray_light(PressLevels.of(presses, MAP), presses, FLAT_FIELD, MAP)
    assert levels is not None
    assert levels.stray_sigma is not None
    assert 0.0 < levels.stray_sigma < 1e-3
    assert taken_out(hazy(STRAY), levels) > 0.0
    assert taken_out(hazy(STRAY), msgspec.structs.replace(levels, stray_sigma=None)) == 0.0
    assert taken_out(hazy(STRAY), None) == 0.0
    assert with_stray_light(levels, presses[:3], FLAT_FIELD, MAP) is levels
    assert with_stray_light(None, presses, FLAT_FIELD, MAP) is None
