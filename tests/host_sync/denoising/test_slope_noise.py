"""Which blur is taken out of a surface: what a lens and demosaicing make, as far as noise allows."""

import numpy as np
import pytest

from device.balls.sphere import BallSamples
from device.imaging.flat_field import DEMOSAIC_BLUR_PX
from device.inverse_map.model import InverseMap
from device.inverse_map.regressor import FeatureRegressor, FeatureScaler
from device.inverse_map.training_domain import TrainingDomain
from host_sync.denoising.bounded_shrinkage import shrinkage_of
from host_sync.denoising.frame_noise import FrameNoise
from host_sync.denoising.slope_noise import BLUR_PX, measure_slope_noise
from host_sync.results.record import SlopeNoise

SHAPE = (200, 300)
WHITE = np.array([1.0, 0.116, 0.0226])
"""Variance of white noise by level, relative to the finest."""


def measured(size: float, *, demosaiced: bool) -> SlopeNoise:
    """Of a map that reads red as p and green as q."""
    wide = np.full(3, 3.0, np.float32)
    coefficients = np.zeros((4, 1, 2), np.float32)
    coefficients[1, 0, 0] = coefficients[2, 0, 1] = 0.3
    curve = FeatureRegressor(
        FeatureScaler(np.zeros(3, np.float32), np.ones(3, np.float32), -wide, wide), 1, 0, coefficients
    )
    known = InverseMap(SHAPE, TrainingDomain.observed(np.ones((4, 3), np.float32)), curve, 1.0)
    rng = np.random.default_rng(0)
    intensity = rng.uniform(0.8, 1.2, (500, 3)).astype(np.float32)
    p, q = (0.1 * rng.standard_normal(500).astype(np.float32) for _ in range(2))
    column, row = (rng.uniform(0.0, side, 500).astype(np.float32) for side in (SHAPE[1], SHAPE[0]))
    noise = FrameNoise(size**2 * np.eye(3), WHITE)
    samples = BallSamples(intensity, p, q, column, row, np.zeros(500, np.intp))
    return measure_slope_noise(noise, shrinkage_of(noise, 1.0), known, samples, demosaiced=demosaiced)


def test_of_a_mosaic_what_interpolation_took_is_given_back_too() -> None:
    of_mosaic, of_colours = (measured(0.002, demosaiced=demosaiced) for demosaiced in (True, False))
    assert of_mosaic.blur_px == pytest.approx(np.hypot(BLUR_PX, DEMOSAIC_BLUR_PX))
    assert of_mosaic.raw_blur_px == DEMOSAIC_BLUR_PX
    assert (of_colours.blur_px, of_colours.raw_blur_px) == (BLUR_PX, 0.0)


def test_the_noise_that_this_adds_is_stated() -> None:
    of_mosaic, of_colours = (measured(0.002, demosaiced=demosaiced) for demosaiced in (True, False))
    assert of_mosaic.raw_kept > 1.05 * of_colours.raw_kept
    assert of_mosaic.shrunk_kept > 1.05 * of_colours.shrunk_kept


def test_loud_noise_leaves_shrunk_detail_as_it_is() -> None:
    loud = measured(0.2, demosaiced=True)
    assert (loud.blur_px, loud.raw_blur_px) == (0.0, DEMOSAIC_BLUR_PX)
