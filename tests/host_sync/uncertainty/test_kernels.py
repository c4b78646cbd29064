"""The passes that uncertainty is put together from, against the same in numpy."""

import numpy as np
import pytest

from host_sync.uncertainty.kernels import (
    piecewise_linear,
    removed_slope,
    sigma_by_tilt,
    squared_tilt,
    with_scale,
)

SHAPE = (30, 50)
NAN = np.float32(np.nan)


def random_field(seed: int, *, low: float = -1.0, high: float = 1.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, SHAPE).astype(np.float32)


@pytest.mark.parametrize("knots", [(0.3,), (0.2, 0.9), (0.1, 0.35, 0.6, 0.93, 0.97, 1.0)])
def test_bends_are_the_function_that_runs_straight_between_knots(knots: tuple[float, ...]) -> None:
    """Both parts the same, no weight, no steepness: σ is √2 of the function at the cosine of the tilt."""
    values = np.linspace(0.02, 0.005, len(knots)) + 0.003 * np.sin(7.0 * np.arange(len(knots)))
    part = piecewise_linear(knots, values)
    p, q, ones = 3.0 * random_field(1), 3.0 * random_field(2), np.ones(SHAPE, np.float32)
    valid, nothing = np.ones(SHAPE, np.bool_), np.zeros(SHAPE, np.float32)
    found = sigma_by_tilt((p, q), (part, part), ones, valid, nothing, nothing)
    square = p.astype(np.float64) ** 2 + q.astype(np.float64) ** 2
    expected = np.interp(1.0 / np.sqrt(1.0 + square), knots, values) * np.sqrt(2.0) * (1.0 + np.minimum(square, 9.0))
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_the_larger_error_counts_beside_the_doubt_and_unknown_slopes_have_none() -> None:
    part = piecewise_linear((0.5, 1.0), (0.01, 0.01))
    p, q, weight = np.zeros(SHAPE, np.float32), np.zeros(SHAPE, np.float32), np.full(SHAPE, 0.25, np.float32)
    valid, nonintegrable = np.ones(SHAPE, np.bool_), np.zeros(SHAPE, np.float32)
    nonintegrable[3, 4], valid[5, 6], p[7, 8] = 0.5, False, NAN
    doubt = np.zeros(SHAPE, np.float32)
    doubt[3, 4] = 1.2
    found = sigma_by_tilt((p, q), (part, part), weight, valid, nonintegrable, doubt)
    assert found[3, 4] == pytest.approx(1.3)
    assert np.isnan(found[5, 6])
    assert np.isnan(found[7, 8])
    assert np.isnan(found).sum() == 2
    assert found[0, 0] == pytest.approx(0.01 * np.sqrt(2.0) * 2.0)


def test_what_is_invalid_stays_out() -> None:
    p, q, z = 4.0 * random_field(3), random_field(4), 100.0 * random_field(5)
    valid = random_field(6) > -0.5
    p[0, 0], valid[0, 0] = NAN, False
    np.testing.assert_allclose(
        squared_tilt(p, q, valid, 9.0), np.where(valid, np.minimum(p * p + q * q, np.float32(9.0)), 0.0), rtol=1e-6
    )
    integrated = q.copy()
    integrated[1, 1], valid[1, 1] = NAN, True
    removed = removed_slope(p, integrated, valid)
    np.testing.assert_array_equal(removed, np.where(valid & np.isfinite(integrated), p - q, np.float32(0.0)))
    total = with_scale(np.abs(q), 0.03, z, valid)
    np.testing.assert_allclose(total, np.where(valid, np.hypot(q, np.float32(0.03) * z), NAN), rtol=1e-5)
