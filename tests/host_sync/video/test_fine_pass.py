"""Passes over a frame of full size do what those of a single frame do, in fewer rounds."""

from __future__ import annotations

import numpy as np
import pytest

from device.balls.sphere import Viewpoint
from device.surface import GradientField, HeightMap
from host_sync.reconstruction.slope_reading import seen_elevation, seen_slopes
from host_sync.video.fine_pass import CoarseReading, FineCorrection, block_moments, level

SHAPE = (60, 90)
CAMERA = Viewpoint(20.0, 33.0, 150.0)


@pytest.mark.parametrize("highest_um", [40.0, 900.0])
@pytest.mark.parametrize("camera", [None, CAMERA])
def test_heights_are_levelled_and_seen_from_the_camera(camera: Viewpoint | None, highest_um: float) -> None:
    """Elevations up to a fiftieth of the camera's height, and up to nine twentieths, which take another way."""
    z_um = np.random.default_rng(1).uniform(-0.1 * highest_um, highest_um, SHAPE).astype(np.float32)
    z_um[3, :7] = z_um[50] = np.nan
    wanted = HeightMap(z_um - np.float32(5.0), 12.0)
    if camera is not None:
        wanted = seen_elevation(wanted, camera)
    largest_um, known = level(HeightMap(z_um, 12.0), 5.0, camera)
    np.testing.assert_allclose(z_um, wanted.z_um, rtol=2e-6, atol=1e-4)
    assert largest_um == pytest.approx(float(np.nanmax(wanted.z_um)), rel=1e-6)
    assert known == np.isfinite(wanted.z_um).sum()


@pytest.mark.parametrize("camera", [None, CAMERA])
def test_corrected_slopes_are_those_that_the_camera_sees(camera: Viewpoint | None) -> None:
    """Gains that are the same everywhere; slopes up to 1."""
    p, q, weight = np.random.default_rng(2).uniform(0.2, 1.0, (3, *SHAPE)).astype(np.float32)
    valid, even = np.ones(SHAPE, np.bool_), np.ones((15, 23), np.float32)
    corrected = GradientField(p + np.float32(0.05), q - np.float32(0.1), valid, 0.5 * weight)
    wanted = corrected if camera is None else seen_slopes(corrected, camera)
    found = GradientField(p, q, valid, weight)
    reading = CoarseReading(found, 0.05 * even, -0.1 * even, 0.5 * even, None, None)
    FineCorrection(reading, 4, camera).apply(found)
    np.testing.assert_allclose(found.p, wanted.p, atol=1e-6)
    np.testing.assert_allclose(found.q, wanted.q, atol=1e-6)
    np.testing.assert_allclose(found.weight, wanted.weight, atol=1e-6)


def test_moments_of_cells_count_what_the_border_leaves_of_them() -> None:
    values = np.random.default_rng(3).uniform(0.0, 2.0, (3, 10, 13)).astype(np.float32)
    mean, square = block_moments(values, 4, (3, 4))
    np.testing.assert_allclose(mean[1, 1, 2], values[1, 4:8, 8:12].mean(), rtol=1e-6)
    np.testing.assert_allclose(mean[2, 2, 3], values[2, 8:, 12:].mean(), rtol=1e-6)
    np.testing.assert_allclose(square[0, 2, 0], np.square(values[0, 8:, :4]).mean(), rtol=1e-6)
