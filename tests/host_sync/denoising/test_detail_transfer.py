"""What shrinkage keeps of fine patterns, and how that bounds its strength."""

from __future__ import annotations

import numpy as np
import pytest

from device.balls.sphere import BallSamples
from host_sync.denoising.bounded_shrinkage import TransferBench, keeps_detail, shrinkage_of
from host_sync.denoising.frame_noise import FrameNoise, SlopeColour

SHAPE = (200, 300)
WHITE = np.array([1.0, 0.116, 0.0226])
"""Variance of white noise by level, relative to the finest."""


def colour() -> SlopeColour:
    """A matt skin under three lights 120 degrees apart, 30 degrees up."""
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt(rng.uniform(0.0, 0.2, 4000)), rng.uniform(0.0, 2.0 * np.pi, 4000)
    p, q = (radius * part for part in (np.cos(angle), np.sin(angle)))
    turns = np.radians([90.0, 210.0, 330.0])
    towards = 1.0 - np.sqrt(3.0) * (p[:, None] * np.cos(turns) + q[:, None] * np.sin(turns))
    intensity = np.maximum(towards / np.sqrt(1.0 + p**2 + q**2)[:, None], 0.05).astype(np.float32)
    column, row = (rng.uniform(0.0, size, 4000).astype(np.float32) for size in (SHAPE[1], SHAPE[0]))
    samples = BallSamples(intensity, p.astype(np.float32), q.astype(np.float32), column, row, np.zeros(4000, np.intp))
    return SlopeColour.of(samples, SHAPE)


def noise(size: float) -> FrameNoise:
    return FrameNoise(size**2 * np.eye(3), WHITE)


def test_colours_of_slopes_are_what_the_balls_showed() -> None:
    found = colour()
    change = found.change((0.2, -0.3))
    turns = np.radians([90.0, 210.0, 330.0])
    expected = -0.5 * np.sqrt(3.0) * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    np.testing.assert_allclose(change, expected, atol=0.08)
    np.testing.assert_allclose(found.root(np.zeros((1, 1)), np.zeros((1, 1)), (0.0, 0.0))[0, 0], 1.0, atol=0.03)


def test_without_noise_everything_is_kept() -> None:
    quiet = noise(1e-5)
    found = TransferBench(colour(), quiet).measure(shrinkage_of(quiet, 1.0))
    np.testing.assert_allclose(found.kept, 1.0, atol=0.02)
    np.testing.assert_allclose(found.ridge_px, found.raw_ridge_px, atol=0.02)


def test_at_a_camera_s_noise_fine_patterns_are_kept_and_faint_ones_lose() -> None:
    """A root's noise of 0.02 is that of a thousand electrons."""
    real = noise(0.02)
    found = TransferBench(colour(), real).measure(shrinkage_of(real, 1.0))
    assert found.at(9.0, 4.0) >= 0.6
    assert found.ridge_px[found.amplitude_deg.index(9.0)] <= 2.0
    assert found.at(2.2, 6.0) < found.at(9.0, 6.0) < found.at(18.0, 6.0)
    assert found.at(18.0, 32.0) > 0.9


def test_louder_noise_and_more_strength_cost_more() -> None:
    bench = TransferBench(colour(), noise(0.03))
    kept = [bench.measure(shrinkage_of(noise(0.03), strength)).at(4.5, 4.0) for strength in (0.25, 0.5, 1.0)]
    assert kept[0] > kept[1] > kept[2]
    quieter = TransferBench(colour(), noise(0.01)).measure(shrinkage_of(noise(0.01), 1.0))
    assert quieter.at(4.5, 4.0) > kept[2]


def test_a_transfer_that_costs_a_ridge_or_a_sinusoid_is_refused() -> None:
    real = noise(0.01)
    good = TransferBench(colour(), real).measure(shrinkage_of(real, 1.0))
    assert keeps_detail(good)
    assert not keeps_detail(replace_ridge(good, 2.6))
    lost = [list(row) for row in good.kept]
    lost[good.amplitude_deg.index(9.0)][good.wavelength_px.index(4.0)] = 0.5
    assert not keeps_detail(
        type(good)(good.amplitude_deg, good.wavelength_px, tuple(map(tuple, lost)), good.ridge_px, 1.8)
    )


def replace_ridge(good, ridge_px: float):  # type: ignore[no-untyped-def]
    return type(good)(good.amplitude_deg, good.wavelength_px, good.kept, (ridge_px,) * len(good.ridge_px), 1.8)


@pytest.mark.parametrize("size", [0.005, 0.02])
def test_the_same_noise_each_time(size: float) -> None:
    bench = TransferBench(colour(), noise(size))
    assert bench.measure(shrinkage_of(noise(size), 1.0)) == bench.measure(shrinkage_of(noise(size), 1.0))
