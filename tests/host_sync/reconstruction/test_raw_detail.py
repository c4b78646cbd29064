"""Raw and shrunk detail on the same long waves."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from device.surface import HeightMap
from host_sync.reconstruction.heights import raw_slope_sigma, with_raw_detail
from host_sync.results.record import SlopeNoise

SHAPE = (203, 310)
NOISE = SlopeNoise((0.0, 20.0, 40.0), (1.0, 1.5, 2.0), (0.5, 0.5, 0.5), 0.4, 0.3, 1.5, 2.0)


def test_detail_is_the_raw_surface_s_and_long_waves_are_the_other_s() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    detail = np.sin(2.0 * np.pi * column / 5.0).astype(np.float32)
    wave = 30.0 * np.sin(2.0 * np.pi * row / 200.0).astype(np.float32)
    shrunk, raw = HeightMap(0.3 * detail + wave, 2.0), HeightMap(detail + 0.7 * wave + 9.0, 2.0)
    found = with_raw_detail(shrunk, raw)
    inner = (slice(40, -40), slice(40, -40))
    assert found.pitch_um == 2.0
    np.testing.assert_allclose((found.z_um - wave)[inner], detail[inner], atol=0.35)
    coarse = [cv2.GaussianBlur(part.z_um, (0, 0), 12.0)[inner] for part in (found, shrunk)]
    np.testing.assert_allclose(coarse[0], coarse[1], atol=0.3)


def test_equal_surfaces_stay_and_what_either_lacks_is_lacking() -> None:
    z_um = np.random.default_rng(0).normal(0.0, 1.0, SHAPE).astype(np.float32)
    holed = z_um.copy()
    holed[50:60, 70:90] = np.nan
    found = with_raw_detail(HeightMap(z_um, 2.0), HeightMap(holed, 2.0))
    np.testing.assert_array_equal(np.isnan(found.z_um), np.isnan(holed))
    seen = np.isfinite(holed)
    np.testing.assert_allclose(found.z_um[seen], z_um[seen], atol=1e-5)


def test_raw_slopes_are_less_sure_by_the_noise_that_shrinkage_took() -> None:
    sigma, flat, steep = (np.full((4, 5), value, np.float32) for value in (0.004, 0.0, np.tan(np.radians(40.0))))
    found = raw_slope_sigma(sigma, flat, flat, NOISE)
    more = (0.4 * np.radians(1.0)) ** 2 - (0.3 * np.radians(0.5)) ** 2
    np.testing.assert_allclose(found, np.sqrt(0.004**2 + more), rtol=1e-5)
    growth = 1.0 + np.tan(np.radians(40.0)) ** 2
    more = ((0.4 * np.radians(2.0)) ** 2 - (0.3 * np.radians(0.5)) ** 2) * growth**2
    np.testing.assert_allclose(raw_slope_sigma(sigma, steep, flat, NOISE), np.sqrt(0.004**2 + more), rtol=1e-3)
    assert raw_slope_sigma(sigma, flat, flat, None) is sigma


def test_variance_grows_with_tilt() -> None:
    square = np.float32([0.0, 0.2, 0.6])
    assert (np.diff(NOISE.variance(square, "raw")) > 0.0).all()
    assert NOISE.added_variance(square)[0] == pytest.approx(
        NOISE.variance(square, "raw")[0] - NOISE.variance(square, "shrunk")[0]
    )
