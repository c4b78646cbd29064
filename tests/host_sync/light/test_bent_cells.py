"""Mean slopes of cells against slopes of their mean normal."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from device.surface import Float32Array, GradientField
from host_sync.denoising.slope_noise import BLUR_PX
from host_sync.light.reading import slopes_hidden_by_means

CELL = 4
SHAPE = (80, 120)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)


def field(p: np.ndarray, q: np.ndarray) -> GradientField:
    p32, q32 = (np.ascontiguousarray(part, np.float32) for part in (p, q))
    return GradientField(p32, q32, np.ones(SHAPE, np.bool_), np.ones(SHAPE, np.float32))


def means(values: np.ndarray) -> np.ndarray:
    return values.reshape(SHAPE[0] // CELL, CELL, SHAPE[1] // CELL, CELL).mean(axis=(1, 3))


def hidden(gradients: GradientField) -> np.ndarray:
    return slopes_hidden_by_means(gradients, (SHAPE[0] // CELL, SHAPE[1] // CELL), CELL)[0]


def of_mean_normal(p: np.ndarray, q: np.ndarray, blur_px: float) -> np.ndarray:
    """Slopes of the mean of unit normals over a camera's blur and cells."""
    length = np.sqrt(1.0 + p * p + q * q)
    x, y, z = (means(cv2.GaussianBlur(part, (0, 0), blur_px)) for part in (p / length, q / length, 1.0 / length))
    return np.stack([x / z, y / z], axis=-1)


def test_bent_skin_is_steeper_than_its_mean_light_shows() -> None:
    p = 0.4 + 0.25 * np.sin(2.0 * np.pi * COLUMN / 18.0)
    q = 0.2 * np.cos(2.0 * np.pi * (COLUMN + 2.0 * ROW) / 25.0)
    mean = np.stack([means(cv2.GaussianBlur(part, (0, 0), BLUR_PX)) for part in (p, q)], axis=-1)
    exact = (mean - of_mean_normal(p, q, BLUR_PX))[2:-2, 2:-2]
    # Pixels show slopes of their own mean normals.
    length = np.sqrt(1.0 + p * p + q * q)
    x, y, z = (cv2.GaussianBlur(part, (0, 0), BLUR_PX) for part in (p / length, q / length, 1.0 / length))
    found = hidden(field(x / z, y / z))[2:-2, 2:-2]
    assert np.abs(exact).max() > 3e-3
    assert np.sqrt(((found - exact) ** 2).mean()) < 0.15 * np.sqrt((exact**2).mean())


@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_an_even_slope_hides_nothing(slope: float) -> None:
    even = np.full(SHAPE, slope)
    assert np.abs(hidden(field(even, -even))).max() < 1e-6


def test_pixels_that_are_not_known_count_for_nothing() -> None:
    p: Float32Array = np.asarray(0.3 + 0.02 * COLUMN / SHAPE[1], np.float32)
    gradients = field(p, np.zeros(SHAPE))
    before = hidden(gradients)
    gradients.p[30:37, 50:61] = np.nan
    gradients.valid[30:37, 50:61] = False
    after = hidden(gradients)
    assert np.isfinite(after).all()
    np.testing.assert_array_equal(after[8, 13], 0.0)
    np.testing.assert_allclose(after[:6], before[:6], atol=1e-6)


def test_of_large_cells_some_pixels_are_enough() -> None:
    p = 0.4 + 0.25 * np.sin(2.0 * np.pi * (COLUMN + 0.7 * ROW) / 31.0)
    gradients = field(p, 0.5 * p)
    some = slopes_hidden_by_means(gradients, (5, 8), 16)[0][:, :-1]
    shortened = 1.0 / np.sqrt(1.0 + 1.25 * p * p)
    every = [part[:, :112].reshape(5, 16, 7, 16).mean(axis=(1, 3)) for part in (p, p * shortened, shortened)]
    np.testing.assert_allclose(some[..., 0], every[0] - every[1] / every[2], rtol=0.15, atol=6e-4)


def test_slopes_that_contradict_each_other_hide_no_more_than_a_tenth() -> None:
    p = np.where((ROW + COLUMN) % 2 == 0, 2.0, 0.2)
    found = hidden(field(p, np.zeros(SHAPE)))
    np.testing.assert_allclose(found[..., 0], 0.11, rtol=1e-3)


def test_the_spread_of_a_cell_is_the_covariance_of_its_normals() -> None:
    p = 0.4 + 0.25 * np.sin(2.0 * np.pi * COLUMN / 18.0)
    q = 0.2 * np.cos(2.0 * np.pi * (COLUMN + 2.0 * ROW) / 25.0)
    spread = slopes_hidden_by_means(field(p, q), (SHAPE[0] // CELL, SHAPE[1] // CELL), CELL)[1]
    length = np.sqrt(1.0 + p * p + q * q)
    x, y = p / length, q / length
    exact = [means(a * b) - means(a) * means(b) for a, b in ((x, x), (x, y), (y, y))]
    assert exact[0].max() > 3e-4
    np.testing.assert_allclose(spread, np.stack(exact, axis=-1), atol=2e-6)
