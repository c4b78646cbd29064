"""Shrinkage of images with known answers, and its one-pass kernel beside the plain form."""

from __future__ import annotations

from itertools import pairwise

import numba
import numpy as np
import pytest

from device.imaging.flat_field import NormalizedImage
from host_sync.denoising.frame_noise import FrameNoise
from host_sync.denoising.wavelet_shrinkage import (
    HALO_PX,
    LEAK,
    LEVELS,
    MIN_ENERGY,
    PARENT_FRACTION,
    REACH_PX,
    SHARES,
    TILE_PX,
    Shrinkage,
    detail_planes,
    shrink,
)
from host_sync.kernels.cell_rows import in_planes

NOISE = FrameNoise(np.diag([1e-4, 2e-4, 1.5e-4]), np.array([1.0, 0.2, 0.05]))
RECIPE = NOISE.shrinkage((0.8, 1.8, 1.8), (0.6, 0.0, 0.0))


def image_of(values: np.ndarray) -> NormalizedImage:
    shape = values.shape[:2]
    return NormalizedImage(values.astype(np.float32), np.ones(shape, np.bool_), np.zeros(shape, np.bool_))


def mixed() -> Shrinkage:
    """A shrinkage whose colours are mixed and whose levels all differ."""
    whitening = np.triu(np.random.default_rng(0).normal(size=(3, 3, 3))).astype(np.float32) * 30.0
    return Shrinkage(whitening, np.float32([0.8, 1.8, 1.2]), np.float32([0.6, 0.1, 0.0]))


DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""(row, column) steps along which energy is averaged."""


def noise_energy(detail: np.ndarray, whitening: np.ndarray) -> np.ndarray:
    """Return the energy of the three colours' detail in units of the noise: float32 array of shape (H, W)."""
    whitened = detail @ whitening.T
    return np.asarray((whitened * whitened).sum(axis=-1) / np.float32(3.0), np.float32)


def with_parent(energy: np.ndarray, coarser: np.ndarray) -> np.ndarray:
    """Return what speaks for a plane's detail: its energy or a share of the next coarser plane's, of the same shape."""
    return np.asarray(np.maximum(energy, np.float32(PARENT_FRACTION) * coarser), np.float32)


def directional_energy(energy: np.ndarray) -> np.ndarray:
    """Return the largest mean of energy along five pixels in four directions, in the shape of `energy`."""
    best = np.full(energy.shape, MIN_ENERGY, np.float32)
    for down, across in DIRECTIONS:
        total = energy.copy()
        for step in range(1, REACH_PX + 1):
            total += _moved(energy, step * down, step * across) + _moved(energy, -step * down, -step * across)
        best = np.maximum(best, total * np.float32(1.0 / (2 * REACH_PX + 1)))
    return best


def _moved(image: np.ndarray, down: int, across: int) -> np.ndarray:
    """Return the image moved by whole pixels; beyond the border the outermost pixels repeat."""
    rows = np.clip(np.arange(image.shape[0]) + down, 0, image.shape[0] - 1)
    columns = np.clip(np.arange(image.shape[1]) + across, 0, image.shape[1] - 1)
    return image[rows][:, columns]


def shrunk_values(values: np.ndarray, shrinkage: Shrinkage) -> np.ndarray:
    """Intensities of shape (H, W, 3) with their noise shrunk, in the plain form; float32 array of the same shape.

    Beyond the border the outermost pixels repeat.
    """
    root = np.sqrt(np.maximum(values, np.float32(0.0)))
    padded = np.pad(root, ((HALO_PX, HALO_PX), (HALO_PX, HALO_PX), (0, 0)), mode="edge")
    details, rest = detail_planes(padded)
    inner = (slice(HALO_PX, -HALO_PX), slice(HALO_PX, -HALO_PX))
    total = rest[inner]
    energies = [noise_energy(detail, white) for detail, white in zip(details, shrinkage.whitening, strict=True)]
    for level in reversed(range(LEVELS - 1)):
        energies[level] = with_parent(energies[level], energies[level + 1])
    for level, detail in enumerate(details):
        energy = directional_energy(energies[level])[inner]
        gain = np.maximum(np.float32(0.0), np.float32(1.0) - (shrinkage.threshold[level] / energy) ** 2)
        gain = shrinkage.kept[level] + (np.float32(1.0) - shrinkage.kept[level]) * gain
        total = total + np.float32(SHARES[level]) * gain[..., None] * detail[inner]
    return np.asarray(total * total, np.float32)


@pytest.mark.parametrize("shape", [(1, 1), (5, 3), (40, 37), (67, 2 * TILE_PX + 11)])
def test_the_kernel_equals_the_plain_form(shape: tuple[int, int]) -> None:
    values = (1.0 + 0.05 * np.random.default_rng(1).standard_normal((*shape, 3))).astype(np.float32)
    values[:: max(shape[0] // 4, 1), :, 1] *= np.float32(-0.5)
    expected = shrunk_values(values, mixed())
    for stored in (values, in_planes(values)):
        found = shrink(
            image_of(values) if stored is values else NormalizedImage(stored, *[values[..., 0] > 0] * 2), mixed()
        )
        np.testing.assert_allclose(found.values, expected, rtol=2e-6, atol=2e-6)
    assert np.abs(expected - np.maximum(values, 0.0)).max() > 0.01 or max(shape) == 1


def test_one_and_two_threads_give_the_same_bits() -> None:
    values = np.random.default_rng(2).lognormal(0.0, 0.1, (400, 500, 3)).astype(np.float32)
    before, found = numba.get_num_threads(), []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            found.append(shrink(image_of(values), RECIPE).values)
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(found[0], found[1])


def test_a_constant_frame_and_a_gentle_ramp_stay_as_they_are() -> None:
    flat = np.full((40, 50, 3), (0.3, 1.0, 1.7), np.float32)
    np.testing.assert_allclose(shrink(image_of(flat), RECIPE).values, flat, rtol=1e-6)
    root = 1.0 + 0.002 * np.arange(50, dtype=np.float32)[None, :, None] * np.ones((40, 1, 3), np.float32)
    found = np.sqrt(shrink(image_of(root**2), RECIPE).values)
    np.testing.assert_allclose(found[:, 10:-10], root[:, 10:-10], atol=2e-6)


def test_a_step_is_kept() -> None:
    values = np.ones((60, 80, 3), np.float32)
    values[:, 40:] = 1.5
    found = shrink(image_of(values), RECIPE).values
    assert np.abs(found - values).max() < 0.02 * 0.5


def test_without_energy_only_the_share_in_any_case_is_kept() -> None:
    """With thresholds beyond all energy the shrinkage is a linear filter, whose noise is known."""
    kept = np.float32([0.6, 0.3, 0.1])
    linear = Shrinkage(NOISE.whitening(), np.full(LEVELS, 1e9, np.float32), kept)
    size = 256
    random = np.random.default_rng(3).standard_normal((size, size, 3)).astype(np.float32)
    found = np.sqrt(shrink(image_of((1.0 + 1e-3 * random) ** 2), linear).values) - 1.0
    frequency = 2.0 * np.pi * np.fft.fftfreq(size)
    passed, smooth = np.zeros((size, size)), np.ones((size, size))
    planes = [smooth]
    for level in range(LEVELS):
        one = 0.5 + 0.5 * np.cos(frequency * 2**level)
        planes.append(planes[-1] * one[:, None] * one[None, :])
    details = [fine - coarse for fine, coarse in pairwise(planes)]
    for level in range(LEVELS):
        leak = LEAK * details[level + 1] if level + 1 < LEVELS else 0.0
        passed += SHARES[level] * kept[level] * (details[level] - leak)
    smooth = planes[-1]
    predicted = 1e-3 * np.sqrt(((passed + smooth) ** 2).mean())
    assert found[16:-16, 16:-16].std() == pytest.approx(predicted, rel=0.02)


def test_the_recipe_takes_most_of_the_noise() -> None:
    noise = NOISE.sample((300, 300), np.random.default_rng(4))
    found = np.sqrt(shrink(image_of((1.0 + noise) ** 2), RECIPE).values) - 1.0
    before, after = (detail_planes(part.astype(np.float32))[0] for part in (noise, found))
    shares = [float(a.std() / b.std()) for a, b in zip(after, before, strict=True)]
    assert shares[0] < 0.85
    assert shares[1] < 0.45
    assert shares[2] < 0.6


def test_a_loud_line_is_kept_and_a_loud_speckle_is_not() -> None:
    """Both are four standard deviations of the noise high; only the line has its energy along itself."""
    height = 4.0 * np.sqrt(np.diag(NOISE.covariance)).astype(np.float32)
    line, speckle = (np.ones((61, 61, 3), np.float32) for _ in range(2))
    line[:, 30] += height
    speckle[30, 30] += height
    of_line, of_speckle = (np.sqrt(shrink(image_of(one**2), RECIPE).values) - 1.0 for one in (line, speckle))
    assert (of_line[30, 30] / height).min() > 0.8
    assert (of_speckle[30, 30] / height).mean() < (of_line[30, 30] / height).mean() - 0.05
