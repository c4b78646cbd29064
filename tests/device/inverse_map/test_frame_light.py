"""Gains and offsets of a frame: estimated from its skin at rest, and removed from its intensity."""

from __future__ import annotations

import numpy as np
import pytest

from device.inverse_map.skin_at_rest import SkinAtRest
from tests.apparatus.drifting_lamps import BALLS, DRIFT, LIGHT, NONE, frame, press, relief

FLAT_FIELD = LIGHT.astype(np.float32)
STRAY = np.array([0.010, 0.012, 0.008])


@pytest.fixture(scope="module")
def at_rest() -> SkinAtRest:
    found = SkinAtRest.of([(press(ball, seed=seed), [ball]) for seed, ball in enumerate(BALLS, 1)], FLAT_FIELD)
    assert found is not None
    return found


@pytest.mark.parametrize("dome", [0.0, 1.0])
@pytest.mark.parametrize("drift", [NONE, DRIFT, 2.0 * DRIFT])
def test_drift_is_estimated_and_removed(at_rest: SkinAtRest, drift: np.ndarray, dome: float) -> None:
    image, steady = frame(drift, dome=dome), frame(dome=dome)
    light = at_rest.evidence(image).light
    light.take_out(image.values, FLAT_FIELD)
    np.testing.assert_allclose(light.offsets, 0.0, atol=8e-4)
    np.testing.assert_allclose(np.median(image.values / steady.values, axis=(0, 1)), 1.0, atol=8e-4)
    np.testing.assert_allclose(image.values / steady.values, 1.0, atol=4e-3)


@pytest.mark.parametrize("dome", [0.0, 1.0])
@pytest.mark.parametrize("drift", [NONE, DRIFT])
def test_stray_light_is_estimated_and_removed_beside_drift(at_rest: SkinAtRest, drift: np.ndarray, dome: float) -> None:
    image, steady = frame(drift, stray=STRAY, dome=dome), frame(dome=dome)
    light = at_rest.evidence(image).light
    np.testing.assert_allclose(light.offsets, STRAY, atol=8e-4)
    np.testing.assert_allclose(np.log(light.gains), drift, atol=3e-3)
    light.take_out(image.values, FLAT_FIELD)
    np.testing.assert_allclose(image.values / steady.values, 1.0, atol=6e-3)


def test_light_of_the_calibration_is_left_within_its_noise(at_rest: SkinAtRest) -> None:
    for seed in range(20, 30):
        light = at_rest.evidence(frame(seed=seed)).light
        assert light.change == 0.0
        assert light.stray == 0.0


def test_drifting_presses_widen_the_prior() -> None:
    drifts = [scale * DRIFT for scale in (-1.0, -0.5, 0.0, 0.4, 0.8, 1.3)]
    presses = [(press(ball, drift, seed), [ball]) for seed, (ball, drift) in enumerate(zip(BALLS, drifts, strict=True))]
    restless = SkinAtRest.of(presses, FLAT_FIELD)
    assert restless is not None
    assert restless.gain_sigma == pytest.approx(np.sqrt(np.mean(np.square(drifts))), rel=0.15)


@pytest.mark.parametrize("slope", [0.02, 0.1, 0.2, 0.4])
def test_skin_beside_an_object_that_covers_most_of_the_field_is_at_rest(at_rest: SkinAtRest, slope: float) -> None:
    evidence = at_rest.evidence(relief(slope))
    assert evidence.has_rest
    assert 0.03 < evidence.fraction < 0.08
    assert evidence.light.change == 0.0
