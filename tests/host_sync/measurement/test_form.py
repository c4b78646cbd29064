"""Forms come off exactly, under masks too; spheres keep their radius."""

import numpy as np
import pytest

from host_sync.errors import MeasurementError
from host_sync.filters.form import PolynomialForm
from host_sync.measurement.circle_and_sphere import SphereForm, fit_sphere
from host_sync.measurement.geometry import SkinPlaces

SHAPE = (180, 240)
PITCH_UM = 4.0


def torn(z_um: np.ndarray) -> np.ndarray:
    z_um = z_um.astype(np.float32)
    z_um[40:90, 100:170] = np.nan
    z_um[:, :3] = np.nan
    return z_um


def polynomial(degree: int) -> np.ndarray:
    row, column = (np.linspace(-1.0, 1.0, side) for side in SHAPE)
    random = np.random.default_rng(degree)
    parts = [
        10.0 * random.standard_normal() * row[:, None] ** i * column**j
        for i in range(degree + 1)
        for j in range(degree + 1 - i)
    ]
    return np.sum(parts, axis=0)


@pytest.mark.parametrize("degree", [0, 1, 2, 4, 8])
def test_a_polynomial_of_the_degree_comes_off_whole(degree: int) -> None:
    z_um = torn(polynomial(degree) + 700.0)
    left = PolynomialForm(np.isfinite(z_um), degree).remove(z_um)
    np.testing.assert_array_equal(np.isnan(left), np.isnan(z_um))
    assert np.nanmax(np.abs(left)) < 1e-3


def test_the_plane_is_that_of_least_squares_on_the_valid_pixels() -> None:
    z_um = torn(polynomial(3) + np.random.default_rng(0).standard_normal(SHAPE))
    left = PolynomialForm(np.isfinite(z_um), 1).remove(z_um)
    row, column = np.nonzero(np.isfinite(z_um))
    design = np.stack([row, column, np.ones(row.size)], axis=-1).astype(np.float64)
    values = z_um[row, column].astype(np.float64)
    expected = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    np.testing.assert_allclose(left[row, column], expected, atol=1e-4)


def test_what_the_pixels_do_not_determine_is_refused() -> None:
    valid = np.zeros(SHAPE, np.bool_)
    valid[50] = True
    with pytest.raises(MeasurementError, match="determine"):
        PolynomialForm(valid, 1)
    with pytest.raises(MeasurementError, match="degree 11"):
        PolynomialForm(valid, 11)


def sphere(radius_um: float, side: float) -> np.ndarray:
    row, column = (np.arange(n) * PITCH_UM for n in SHAPE)
    square = (column - 500.0) ** 2 + (row[:, None] - 350.0) ** 2
    return side * np.sqrt(radius_um**2 - square) + 12.0


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("radius_um", [900.0, 20_000.0])
def test_a_sphere_is_found_and_comes_off(radius_um: float, side: float) -> None:
    z_um = torn(sphere(radius_um, side))
    found = fit_sphere(z_um, SkinPlaces(PITCH_UM))
    assert found.radius_um == pytest.approx(side * radius_um, rel=1e-4)
    assert (found.column_um, found.row_um) == pytest.approx((500.0, 350.0), abs=0.2)
    left = SphereForm(SkinPlaces(PITCH_UM)).remove(z_um)
    assert np.nanmax(np.abs(left)) < 0.02


def test_noise_on_a_sphere_leaves_its_radius_unbiased() -> None:
    noise = np.random.default_rng(2).standard_normal(SHAPE)
    found = fit_sphere(torn(sphere(2000.0, 1.0) + 2.0 * noise), SkinPlaces(PITCH_UM))
    assert found.radius_um == pytest.approx(2000.0, rel=3e-3)
    assert found.residual_um == pytest.approx(2.0, rel=0.1)


def test_a_plane_is_no_sphere() -> None:
    with pytest.raises(MeasurementError, match="no sphere"):
        fit_sphere(np.zeros(SHAPE, np.float32), SkinPlaces(PITCH_UM))
    with pytest.raises(MeasurementError, match="four valid pixels"):
        fit_sphere(np.full(SHAPE, np.nan, np.float32), SkinPlaces(PITCH_UM))
