"""What shrinkage took of detail that was drawn, against the detail that is missing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from host_sync.results.record import SlopeNoise
from host_sync.uncertainty.kernels import CELL_PX, lost_variance, with_lost_detail

SHAPE = (200, 280)
NOISE = 0.01
RECORD = SlopeNoise((10.0,), (np.degrees(NOISE),), (np.degrees(0.3 * NOISE),), 1.0, 1.0, 1.0, 1.0)


def white(seed: int, amplitude: float, smooth_px: float = 0.0) -> list[np.ndarray]:
    """Two slopes, float32 arrays of shape (H, W), with this standard deviation."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(2):
        one = random.standard_normal(SHAPE)
        one = gaussian_filter(one, smooth_px) if smooth_px else one
        found.append((amplitude * one / one.std()).astype(np.float32))
    return found


def lost_slope(detail: list[np.ndarray], kept: float) -> float:
    """Root mean square slope that is reported missing where a share `kept` of detail and noise was kept."""
    raw = [one + noise for one, noise in zip(detail, white(1, NOISE), strict=True)]
    shrunk = [np.float32(kept) * one for one in raw]
    return float(np.sqrt(lost_variance((raw[0], raw[1]), (shrunk[0], shrunk[1]), RECORD).mean()))


def test_detail_that_was_taken_with_the_noise_is_missing() -> None:
    detail = white(2, 2.0 * NOISE, smooth_px=1.0)
    assert lost_slope(detail, 0.2) == pytest.approx(np.sqrt(2.0) * 0.8 * 2.0 * NOISE, rel=0.25)
    assert lost_slope(detail, 0.2) > lost_slope(detail, 0.5) > 0.3 * NOISE


def test_noise_alone_loses_nothing_and_kept_detail_neither() -> None:
    nothing = [np.zeros(SHAPE, np.float32)] * 2
    assert lost_slope(nothing, 0.2) < 0.1 * NOISE
    assert lost_slope(white(2, 4.0 * NOISE, smooth_px=1.0), 1.0) == 0.0


def test_long_waves_are_no_fine_detail() -> None:
    across = np.arange(SHAPE[1]) + np.zeros(SHAPE)
    wave = (0.3 * np.sin(2.0 * np.pi * across / 80.0)).astype(np.float32)
    noise = white(1, NOISE)
    raw, shrunk = (wave + noise[0], noise[1]), (wave + 0.3 * noise[0], 0.3 * noise[1])
    assert np.sqrt(lost_variance(raw, shrunk, RECORD).mean()) < 0.5 * NOISE


def test_where_slopes_are_no_numbers_nothing_is_missing() -> None:
    raw = [one + np.float32(0.0) for one in white(2, 4.0 * NOISE, smooth_px=1.0)]
    for one in raw:
        one[:100] = np.nan
    lost = lost_variance((raw[0], raw[1]), (0.2 * raw[0], 0.2 * raw[1]), RECORD)
    assert lost.shape == (SHAPE[0] // CELL_PX, SHAPE[1] // CELL_PX)
    assert np.isfinite(lost).all()
    assert lost[:15].max() == 0.0
    sigma = np.where(np.isnan(raw[0]), np.float32(np.nan), np.float32(0.005))
    more = with_lost_detail(sigma, lost)
    np.testing.assert_array_equal(np.isnan(more), np.isnan(sigma))
    assert (more[110:] >= np.float32(0.005)).all()
    np.testing.assert_allclose(more[140, 140], np.hypot(0.005, np.sqrt(lost[34:36, 34:36].mean())), rtol=0.2)


@pytest.mark.parametrize("shape", [(40, 7), (41, 60), (22, 3)])
def test_rows_and_columns_count_alike_on_any_field(shape: tuple[int, int]) -> None:
    raw = [one[: shape[0], : shape[1]].copy() for one in white(2, 4.0 * NOISE, smooth_px=1.0)]
    raw[0][2, 1] = np.nan
    shrunk = [np.float32(0.3) * one for one in raw]
    found = lost_variance((raw[0], raw[1]), (shrunk[0], shrunk[1]), RECORD)
    turned = [np.ascontiguousarray(one.T) for one in (*raw, *shrunk)]
    assert found.max() > 0.0
    np.testing.assert_allclose(
        lost_variance((turned[0], turned[1]), (turned[2], turned[3]), RECORD).T, found, rtol=1e-4
    )
