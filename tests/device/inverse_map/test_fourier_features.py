"""Waves of colour: what they are, that a curve keeps them, and that a skin that needs them gets them."""

from dataclasses import replace

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples, sphere_slopes
from device.calibration.candidates import Lesson
from device.errors import RecordError
from device.inverse_map.regressor import (
    AMPLITUDE,
    MAX_WAVES,
    WAVES,
    FeatureRegressor,
    FeatureScaler,
    RandomFourierFeatures,
    colour_exponents,
    position_exponents,
)

SHAPE = (240, 320)


def curve() -> FeatureRegressor:
    random = np.random.default_rng(0)
    colours = random.lognormal(0.0, 0.3, (500, 3)).astype(np.float32)
    terms = (len(colour_exponents(2)) + WAVES, len(position_exponents(1)), 2)
    coefficients = random.standard_normal(terms).astype(np.float32)
    return FeatureRegressor(FeatureScaler.observed(colours), 2, 1, coefficients, RandomFourierFeatures.sample())


def samples_of(sharpness: float) -> BallSamples:
    """Twelve balls on a skin whose channels answer a tilt along their axis with tanh(sharpness times it)."""
    random = np.random.default_rng(4)
    places = [(column, row) for row in (45.0, 120.0, 195.0) for column in (50.0, 125.0, 200.0, 270.0)]
    parts = []
    for number, (column, row) in enumerate(places):
        at = random.uniform(-30.0, 30.0, (400, 2))
        at = at[np.hypot(*at.T) < 30.0].astype(np.float32)
        p, q = sphere_slopes(Ball(0.0, 0.0, 32.0, 50.0), at[:, 0], at[:, 1])
        axes = np.radians([90.0, 210.0, 330.0])
        tilt = -(p[:, None] * np.cos(axes) + q[:, None] * np.sin(axes))
        seen = 1.0 + 0.5 * np.tanh(sharpness * tilt) / np.tanh(sharpness) + 0.1 * tilt
        seen += 0.005 * random.standard_normal(seen.shape)
        parts.append((seen, p, q, column + at[:, 0], row + at[:, 1], np.full(len(at), number)))
    columns = [np.concatenate(part) for part in zip(*parts, strict=True)]
    return BallSamples(*(part.astype(np.float32) for part in columns[:5]), columns[5].astype(np.intp))


def test_waves_are_cosines_of_colour_and_the_same_each_time() -> None:
    waves, variables = RandomFourierFeatures.sample(), np.random.default_rng(1).normal(size=(2000, 3))
    np.testing.assert_array_equal(waves.direction, RandomFourierFeatures.sample().direction)
    values = waves.values(variables)
    np.testing.assert_allclose(
        values[:, 3], waves.amplitude * np.cos(variables @ waves.direction[:, 3] + waves.phase[3]), atol=1e-6
    )
    assert np.sqrt((values**2).sum(axis=1).mean()) == pytest.approx(AMPLITUDE, rel=0.1)


def test_a_curve_keeps_its_waves() -> None:
    kept = FeatureRegressor.from_arrays(curve().arrays(), "map.npz")
    colours, place = np.full((3, 3), 0.9, np.float32), np.array([[0.0, 0.0], [0.5, -0.5], [1.0, 1.0]])
    np.testing.assert_array_equal(kept.at(colours, place), curve().at(colours, place))
    assert "wave_phase" not in replace(curve(), waves=RandomFourierFeatures.none()).arrays()


@pytest.mark.parametrize(
    "phase", [np.zeros((2, 2), np.float32), np.full(WAVES, np.nan), np.zeros(MAX_WAVES + 1, np.float32)]
)
def test_waves_that_are_none_are_refused(phase: np.ndarray) -> None:
    with pytest.raises((ValueError, RecordError)):
        FeatureRegressor.from_arrays(curve().arrays() | {"wave_phase": phase}, "map.npz")


def test_missing_waves_do_not_pass_for_a_polynomial() -> None:
    arrays = {name: array for name, array in curve().arrays().items() if not name.startswith("wave_")}
    with pytest.raises(RecordError, match="coefficients"):
        FeatureRegressor.from_arrays(arrays, "map.npz")


@pytest.mark.parametrize(("sharpness", "wavy"), [(0.5, False), (8.0, True)])
def test_only_a_skin_that_bends_sharply_gets_waves(sharpness: float, wavy: bool) -> None:
    samples = samples_of(sharpness)
    slope = np.stack([samples.p, samples.q], axis=-1).astype(np.float64)
    learner, _ = Lesson(samples, slope, 12, SHAPE).select_best()
    assert (learner.form.waves.count > 0) == wavy


def test_few_balls_get_no_waves() -> None:
    samples = samples_of(8.0)
    few = samples.select(np.flatnonzero(samples.ball < 4))
    learner, _ = Lesson(few, np.stack([few.p, few.q], axis=-1).astype(np.float64), 4, SHAPE).select_best()
    assert learner.form.waves.count == 0
