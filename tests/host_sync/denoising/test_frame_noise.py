"""Noise that is drawn is measured as what it is, beside edges too."""

from __future__ import annotations

import numpy as np
import pytest

from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage
from host_sync.denoising.frame_noise import FrameNoise, measure_noise, robust_covariance
from host_sync.denoising.wavelet_shrinkage import detail_planes

COVARIANCE = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.4], [0.5, -0.4, 6.0]]) * 1e-5


@pytest.mark.parametrize("ratios", [(1.0, 0.116, 0.0226), (0.9, 0.45, 0.27)])
def test_drawn_noise_has_its_covariance_and_levels(ratios: tuple[float, float, float]) -> None:
    noise = FrameNoise(COVARIANCE, np.array(ratios)).sample((400, 400), np.random.default_rng(0))
    details, _ = detail_planes(noise)
    finest = ratios[0] * COVARIANCE
    np.testing.assert_allclose(robust_covariance(details[0].reshape(-1, 3)), finest, rtol=0.15, atol=4e-7)
    power = [float((detail[16:-16, 16:-16] ** 2).mean()) for detail in details]
    np.testing.assert_allclose(np.array(power) / power[0], np.array(ratios) / ratios[0], rtol=0.3)


def test_noise_of_frames_is_found_beside_edges() -> None:
    known = FrameNoise(COVARIANCE, np.array([1.0, 0.3, 0.1]))
    rng = np.random.default_rng(1)
    root = 1.0 + known.sample((200, 260), rng)
    root[:, 60:64] += 0.2
    root[90:, :] *= 0.8
    everywhere = np.ones((200, 260), np.bool_)
    image = NormalizedImage((root**2).astype(np.float32), everywhere, ~everywhere)
    untouched = ((1.0 + known.sample((200, 260), rng)) ** 2).astype(np.float32)
    found = measure_noise([(image, [Ball(70.0, 80.0, 50.0, 70.0), Ball(180.0, 80.0, 50.0, 70.0)])], [untouched])
    assert found is not None
    np.testing.assert_allclose(found.covariance, COVARIANCE, rtol=0.2, atol=6e-7)
    np.testing.assert_allclose(found.ratios, known.ratios, rtol=0.3)


def test_too_few_pixels_show_no_noise() -> None:
    everywhere = np.ones((40, 40), np.bool_)
    image = NormalizedImage(np.ones((40, 40, 3), np.float32), everywhere, ~everywhere)
    assert measure_noise([(image, [Ball(20.0, 20.0, 5.0, 9.0)])], [image.values]) is None


def test_whitened_noise_has_energy_one() -> None:
    noise = FrameNoise(COVARIANCE, np.array([1.0, 0.25, 0.04]))
    rng = np.random.default_rng(2)
    for level, ratio in enumerate(noise.ratios):
        sample = rng.multivariate_normal(np.zeros(3), ratio * COVARIANCE, 20_000)
        energy = ((sample @ noise.whitening()[level].T) ** 2).sum(axis=1) / 3.0
        assert energy.mean() == pytest.approx(1.0, rel=0.02)
