"""Noise of three colours that no slope makes is taken off slopes, and detail stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from device.balls.sphere import BallSamples
from device.inverse_map.model import InverseMap
from device.inverse_map.regressor import DARK_OFFSET, FeatureRegressor, FeatureScaler
from device.inverse_map.training_domain import TrainingDomain
from device.surface import slope_from_stereographic, stereographic_from_slope
from host_sync.denoising.bounded_shrinkage import shrinkage_of
from host_sync.denoising.frame_noise import MAX_MISREAD, FrameNoise, NullColour, learn_null_colour
from host_sync.denoising.slope_noise import measure_slope_noise

SHAPE = (200, 300)
SLOPE_PER_LOG = 0.6
STEEPEST = 0.15
NOISE = FrameNoise(0.01**2 * np.eye(3), np.array([1.0, 0.116, 0.0226]))
BOUND = np.sqrt(2.0 / 3.0)
"""Noise of slopes by least squares of three colours that rise along p, along q and against both, over that of two."""


def colour_of(u: np.ndarray) -> np.ndarray:
    """Intensity whose red rises along p, green along q, and blue against both, as logarithms."""
    logs = np.column_stack([u, -u.sum(axis=1)]) / SLOPE_PER_LOG
    return ((1.0 + DARK_OFFSET) * np.exp(logs) - DARK_OFFSET).astype(np.float32)


def places(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    column, row = (rng.uniform(0.0, side, count).astype(np.float32) for side in (SHAPE[1], SHAPE[0]))
    return column, row


@pytest.fixture(scope="module")
def samples() -> BallSamples:
    rng = np.random.default_rng(0)
    u = rng.uniform(-STEEPEST, STEEPEST, (6000, 2))
    p, q = slope_from_stereographic(u).T.astype(np.float32)
    return BallSamples(colour_of(u), p, q, *places(len(u), rng), np.zeros(len(u), np.intp))


@pytest.fixture(scope="module")
def two_colours(samples: BallSamples) -> InverseMap:
    """A map that reads red and green and is blind to blue."""
    wide, coefficients = np.full(3, 3.0, np.float32), np.zeros((4, 1, 2), np.float32)
    coefficients[2, 0, 1] = coefficients[3, 0, 0] = SLOPE_PER_LOG
    centre = np.full(3, np.log(1.0 + DARK_OFFSET), np.float32)
    curve = FeatureRegressor(FeatureScaler(centre, np.ones(3, np.float32), -wide, wide), 1, 0, coefficients)
    return InverseMap(SHAPE, TrainingDomain.observed(samples.intensity), curve, STEEPEST)


@pytest.fixture(scope="module")
def null_colour(samples: BallSamples, two_colours: InverseMap) -> NullColour:
    found = learn_null_colour(samples, two_colours, NOISE)
    assert found is not None
    return found


def test_the_map_reads_what_was_drawn(samples: BallSamples, two_colours: InverseMap) -> None:
    read = two_colours.predict(samples.intensity, samples.column, samples.row)
    np.testing.assert_allclose(read, np.column_stack([samples.p, samples.q]), atol=1e-5)


@pytest.mark.parametrize("u", [(0.0, 0.0), (0.1, -0.05), (-0.1, -0.1)])
def test_noise_of_slopes_falls_to_that_of_three_colours(
    two_colours: InverseMap, null_colour: NullColour, u: tuple[float, float]
) -> None:
    rng = np.random.default_rng(1)
    shrunk = colour_of(np.tile(u, (20_000, 1)))
    seen = ((np.sqrt(shrunk) + 0.01 * rng.standard_normal(shrunk.shape)) ** 2).astype(np.float32)
    place = places(len(seen), rng)
    plain, better = two_colours.predict(seen, *place), null_colour.read(two_colours, seen, shrunk, *place)
    np.testing.assert_allclose(better.mean(axis=0), plain.mean(axis=0), atol=1e-3)
    share = np.sqrt(better.var(axis=0).sum() / plain.var(axis=0).sum())
    if u == (0.0, 0.0):
        assert share == pytest.approx(BOUND, rel=0.03)
    assert share < 0.9


def test_detail_that_was_shrunk_is_read_as_it_is(two_colours: InverseMap, null_colour: NullColour) -> None:
    rng = np.random.default_rng(2)
    base = rng.uniform(-0.8 * STEEPEST, 0.8 * STEEPEST, (20_000, 2))
    detail = rng.normal(0.0, 0.01, base.shape)
    shrunk, seen = colour_of(base), colour_of(base + detail)
    read = stereographic_from_slope(*null_colour.read(two_colours, seen, shrunk, *places(len(base), rng)).T) - base
    assert (read * detail).sum() / (detail**2).sum() == pytest.approx(1.0, abs=0.01)
    assert np.sqrt(((read - detail) ** 2).sum() / (detail**2).sum()) < 1.2 * MAX_MISREAD


def test_nothing_is_taken_off_what_was_not_shrunk(
    samples: BallSamples, two_colours: InverseMap, null_colour: NullColour
) -> None:
    place = samples.column, samples.row
    read = null_colour.read(two_colours, samples.intensity, samples.intensity, *place)
    np.testing.assert_allclose(read, two_colours.predict(samples.intensity, *place), atol=1e-6)


def test_the_noise_that_is_stated_is_what_is_left(
    samples: BallSamples, two_colours: InverseMap, null_colour: NullColour
) -> None:
    plain, better = [
        measure_slope_noise(NOISE, shrinkage_of(NOISE, 1.0), two_colours, samples, by) for by in (None, null_colour)
    ]
    assert better.raw_deg[0] < 0.9 * plain.raw_deg[0]
    for name in ("tilt_deg", "shrunk_deg", "shrunk_kept", "shrunk_height_px", "blur_px"):
        assert getattr(better, name) == getattr(plain, name)
    assert better.raw_kept == pytest.approx(plain.raw_kept, rel=0.05)


def test_quiet_frames_need_no_null_colour(samples: BallSamples, two_colours: InverseMap) -> None:
    silent = FrameNoise(1e-10 * np.eye(3), NOISE.ratios)
    found = learn_null_colour(samples, two_colours, silent)
    assert found is not None
    u, rng = np.zeros((100, 2)), np.random.default_rng(3)
    detail = rng.normal(0.0, 0.03, u.shape)
    noise = found.noise(u, u, colour_of(detail) - colour_of(u))
    assert np.abs(noise).max() < 1e-3


def test_without_noise_or_light_there_is_no_null_colour(samples: BallSamples, two_colours: InverseMap) -> None:
    silent = FrameNoise(np.zeros((3, 3)), NOISE.ratios)
    assert learn_null_colour(samples, two_colours, silent) is None
    black = replace(samples, intensity=np.zeros_like(samples.intensity))
    assert learn_null_colour(black, two_colours, NOISE) is None


def test_few_pixels_show_nothing(samples: BallSamples, two_colours: InverseMap) -> None:
    assert learn_null_colour(samples.select(np.arange(100)), two_colours, NOISE) is None


def test_a_ball_alone_says_nothing_of_the_rest_of_the_field(samples: BallSamples, two_colours: InverseMap) -> None:
    near = replace(samples, column=20.0 + 0.05 * samples.column, row=20.0 + 0.05 * samples.row)
    found = learn_null_colour(near, two_colours, NOISE)
    assert found is not None
    for part in (found.channels, found.slopes):
        assert np.abs(part[0, 1:]).max() < 0.05 * np.abs(part[0, 0]).max()
