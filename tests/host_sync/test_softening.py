"""What softening costs in resolution and saves in noise."""

import numpy as np
import pytest

from device.photometry import IntensityImage
from host_sync.softening import softened

SHAPE = (64, 80)


def image_of(values: np.ndarray, clipped: np.ndarray | None = None) -> IntensityImage:
    stacked = np.repeat(values[..., None], 3, axis=-1).astype(np.float32)
    return IntensityImage(stacked, np.ones(SHAPE, bool), np.zeros(SHAPE, bool) if clipped is None else clipped)


@pytest.mark.parametrize("turn", [0.0, 0.5, np.pi / 4])
@pytest.mark.parametrize("phase", [0.0, 0.7])
def test_a_sinusoid_of_four_pixels_keeps_more_than_half(turn: float, phase: float) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    wave = np.cos(2.0 * np.pi * (column * np.cos(turn) + row * np.sin(turn)) / 4.0 + phase)
    soft = softened(image_of(1.0 + 0.2 * wave)).values[8:-8, 8:-8, 0] - 1.0
    kept = float((soft * wave[8:-8, 8:-8]).sum() / (wave[8:-8, 8:-8] ** 2).sum() / 0.2)
    assert 0.55 < kept < 0.65


def test_a_line_of_one_pixel_stays_narrow() -> None:
    line = np.zeros(SHAPE)
    line[:, 40] = 1.0
    profile = softened(image_of(line)).values[32, :, 0]
    assert profile[40] > 0.5
    assert profile[41] < 0.5 * profile[40]


def test_noise_of_pixels_falls_to_less_than_half_and_the_mean_stays() -> None:
    noisy = 1.0 + 0.1 * np.random.default_rng(0).standard_normal(SHAPE)
    soft = softened(image_of(noisy)).values[..., 0]
    assert soft.std() < 0.05
    assert soft.mean() == pytest.approx(noisy.mean(), abs=1e-3)


def test_the_neighbours_of_a_clipped_pixel_count_as_clipped() -> None:
    clipped = np.zeros(SHAPE, bool)
    clipped[20, 30] = True
    soft = softened(image_of(np.ones(SHAPE), clipped))
    assert soft.clipped[19:22, 29:32].all()
    assert soft.clipped.sum() == 9
