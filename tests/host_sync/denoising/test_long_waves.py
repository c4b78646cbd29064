"""What shrinkage leaves of long waves and of fine detail, against the image that was drawn."""

from __future__ import annotations

import numpy as np
import pytest

from device.imaging.flat_field import NormalizedImage
from host_sync.denoising.bounded_shrinkage import shrinkage_of
from host_sync.denoising.frame_noise import FrameNoise
from host_sync.denoising.wavelet_shrinkage import detail_planes, shrink, shrink_but_long_waves
from host_sync.kernels.cell_rows import in_planes

SIGMA = 0.01
SHAPE = (320, 480)


def white_noise(seed: int) -> np.ndarray:
    return np.asarray(SIGMA * np.random.default_rng(seed).standard_normal((*SHAPE, 3)), np.float32)


def levels_of(noise: np.ndarray) -> FrameNoise:
    """The noise as it would be measured: of the finest detail with its leak, and of the levels."""
    finest = float(detail_planes(noise, levels=1)[0][0].var())
    return FrameNoise(finest * np.eye(3), np.array([float(one.var()) for one in detail_planes(noise)[0]]) / finest)


RECIPE = shrinkage_of(levels_of(white_noise(0)), 1.0)


def wave(period_px: float, amplitude: float) -> np.ndarray:
    """Root of intensity of shape (H, W, 3)."""
    down, across = np.mgrid[: SHAPE[0], : SHAPE[1]]
    one = amplitude * np.sin(2.0 * np.pi * across / period_px) * np.sin(2.0 * np.pi * down / period_px)
    return np.repeat((1.0 + one)[..., None], 3, axis=2)


def image_of(root: np.ndarray) -> NormalizedImage:
    noisy = root + white_noise(1)
    everywhere = np.ones(SHAPE, np.bool_)
    return NormalizedImage(np.asarray(noisy**2, np.float32), everywhere, ~everywhere)


def kept(shrunk: NormalizedImage, root: np.ndarray) -> float:
    """Share of the drawn wave that is left, by regression inside the frame."""
    inner = (slice(40, -40), slice(40, -40))
    drawn = (root**2 - (root**2).mean())[inner]
    return float((shrunk.values[inner] * drawn).sum() / (drawn**2).sum())


@pytest.mark.parametrize("period_px", [80.0, 120.0])
def test_long_wave_keeps_its_amplitude(period_px: float) -> None:
    root = wave(period_px, 0.05)
    image = image_of(root)
    bare = kept(shrink(image, RECIPE), root)
    assert bare < 0.99  # the judge sees the loss
    assert abs(kept(shrink_but_long_waves(image, RECIPE), root) - 1.0) < 0.3 * (1.0 - bare)


def test_untouched_skin_is_as_quiet_as_before() -> None:
    image = image_of(wave(80.0, 0.0))
    bare, left = (one.values.std() for one in (shrink(image, RECIPE), shrink_but_long_waves(image, RECIPE)))
    assert left < 1.05 * bare
    assert bare < 0.7 * image.values.std()


def test_fine_detail_is_shrunk_as_before() -> None:
    image = image_of(wave(12.0, 0.02))
    bare, whole = shrink(image, RECIPE).values, shrink_but_long_waves(image, RECIPE).values
    given, lost = (part - part.mean() for part in (whole - bare, image.values - bare))
    assert 0.0 < given.std() < 0.15 * lost.std()


def test_planes_and_pixels_come_to_the_same() -> None:
    image = image_of(wave(80.0, 0.05))
    by_plane = NormalizedImage(in_planes(image.values), image.valid, image.clipped)
    one, other = (shrink_but_long_waves(part, RECIPE).values for part in (image, by_plane))
    np.testing.assert_array_equal(one, other)
