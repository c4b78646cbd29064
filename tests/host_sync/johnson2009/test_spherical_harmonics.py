import numpy as np
import pytest

from host_sync.calibration_report.paper_figures import _smoothed
from host_sync.johnson2009.spherical_harmonics import (
    CELLS,
    ReflectanceMaps,
    fit_harmonics,
    harmonics,
    harmonics_of_normal,
    reflectance_surface,
)


def test_the_harmonics_are_orthonormal_over_the_sphere():
    nodes, weights = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * 2.0 * np.pi / 16
    z, phi = (grid.ravel() for grid in np.meshgrid(nodes, azimuth))
    area = np.tile(weights, 16) * 2.0 * np.pi / 16
    level = np.sqrt(1.0 - z * z)
    value, _ = harmonics_of_normal(level * np.cos(phi), level * np.sin(phi), z, 5)
    np.testing.assert_allclose(value.T @ (value * area[:, None]), np.eye(36), atol=1e-12)


def test_derivatives_match_differences():
    p, q = np.random.default_rng(1).normal(size=(2, 40))
    step = 1e-5
    _, by_p, by_q = harmonics(p, q, 5)
    along_p = (harmonics(p + step, q, 5)[0] - harmonics(p - step, q, 5)[0]) / (2 * step)
    along_q = (harmonics(p, q + step, 5)[0] - harmonics(p, q - step, 5)[0]) / (2 * step)
    np.testing.assert_allclose(by_p, along_p, atol=1e-7)
    np.testing.assert_allclose(by_q, along_q, atol=1e-7)


def observed_maps(reflectance, reach=1.2):
    """Maps of a reflectance seen without noise inside the disc of `reach`."""
    centres = (np.arange(CELLS) + 0.5) * 2 * reach / CELLS - reach
    p, q = np.meshgrid(centres, centres)
    seen = p * p + q * q < reach**2
    mean = np.where(seen[..., None], reflectance(p, q), np.nan)
    return ReflectanceMaps(reach, mean, np.where(seen[..., None], 1e-6, np.nan), np.where(seen, 9, 0))


def lambertian(p, q):
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(1 + p * p + q * q)[..., None]
    lights = np.array([[0.8, 0.0, 0.6], [-0.4, 0.7, 0.6], [-0.4, -0.7, 0.6]])
    return 0.2 + normal @ lights.T


@pytest.mark.parametrize("order", [2, 5])
def test_a_lambertian_skin_is_reproduced_by_either_order(order):
    fit = fit_harmonics(observed_maps(lambertian), order)
    assert max(fit.residual) < 1e-5
    steep = np.array([1.8]), np.array([-0.9])
    np.testing.assert_allclose(fit.reflectance(*steep), lambertian(*steep), atol=1e-3)


def test_slopes_that_are_seen_once_leave_no_gap():
    maps = observed_maps(lambertian)
    row, column = np.mgrid[:CELLS, :CELLS] - CELLS // 2
    few = (np.hypot(row, column) < 0.15 * CELLS) & (row % 4 == 0) & (column % 4 == 0)
    once = ReflectanceMaps(maps.reach, maps.mean, np.full_like(maps.variance, np.nan), few.astype(np.int64))
    assert np.isfinite(reflectance_surface(once, fit_harmonics(once)).on_grid(np.linspace(-1.2, 1.2, 5))).all()
    assert np.isfinite(_smoothed(once)).any()


def lobed(p, q):
    return lambertian(p, q) + np.exp(-((p - 0.4) ** 2 + q**2) / 0.3)[..., None]


def test_order_5_follows_a_lobe_that_order_2_cannot():
    maps = observed_maps(lobed)
    two, five = fit_harmonics(maps, 2), fit_harmonics(maps, 5)
    assert max(five.residual) < 0.5 * min(two.residual)


def test_the_fill_beyond_the_observed_slopes_stays_tame():
    fit = fit_harmonics(observed_maps(lobed, reach=0.8))
    p, q = (slope.ravel() for slope in np.meshgrid(*[np.linspace(-2.0, 2.0, 41)] * 2))
    assert np.abs(fit.reflectance(p, q)).max() < 4.0


def test_the_jacobian_is_that_of_the_sum():
    fit = fit_harmonics(observed_maps(lobed))
    p, q, step = np.array([0.3, -0.5]), np.array([0.1, 0.6]), 1e-5
    value, jacobian = fit.with_jacobian(p, q)
    np.testing.assert_allclose(value, fit.reflectance(p, q))
    along = (fit.reflectance(p + step, q) - fit.reflectance(p - step, q)) / (2 * step)
    np.testing.assert_allclose(jacobian[..., 0], along, atol=1e-6)
