"""Roughness and differences read on the device agree with the workstation's on the same map."""

import numpy as np
import pytest

from device.quick_look.measures import (
    SECTIONS,
    areal_roughness,
    difference,
    levelled,
    line_between,
    line_roughness,
    mean_line,
)
from device.surface.fields import HeightMap
from device.tui.drawing.measure_text import measure_text
from host_sync.filters.form import PolynomialForm
from host_sync.filters.profile_filter import profile_mean
from host_sync.iso25178.areal_parameters import height_parameters
from host_sync.profile.profile_line import Profile
from host_sync.profile.profile_parameters import profile_parameters

PITCH_UM = 24.0


@pytest.fixture
def height() -> HeightMap:
    row, column = np.mgrid[:180, :240].astype(np.float32)
    rng = np.random.default_rng(4)
    z_um = 0.3 * column + 0.1 * row + 8.0 * np.sin(column / 5.0) + rng.normal(0.0, 0.4, row.shape)
    z_um[20:24, 30:33] = np.nan
    return HeightMap(z_um.astype(np.float32), PITCH_UM)


def test_area_agrees_with_the_workstation(height: HeightMap) -> None:
    flat = levelled(height.z_um)
    assert np.nanmax(np.abs(flat - PolynomialForm(np.isfinite(height.z_um), 1).remove(height.z_um))) < 1e-3
    theirs, ours = height_parameters(flat), areal_roughness(flat)
    assert ours.mean_um == pytest.approx(theirs["Sa"], rel=1e-6)
    assert ours.total_um == pytest.approx(theirs["Sz"], rel=1e-6)


@pytest.mark.parametrize("row", [3, 22])
def test_a_line_agrees_with_the_workstation(height: HeightMap, row: int) -> None:
    line = line_between(height, (row, 0.0), (row, 239.0))
    np.testing.assert_array_equal(np.isnan(line[34:]), False)
    ours = line_roughness(line, PITCH_UM)
    assert ours.cutoff_um == 800.0
    cutoff = 800.0 / PITCH_UM
    np.testing.assert_allclose(mean_line(line, cutoff), profile_mean(line, cutoff), atol=1e-9)
    profile = Profile(line - profile_mean(line, cutoff), PITCH_UM)
    theirs = profile_parameters(profile, SECTIONS, "R")
    assert ours.mean_um == pytest.approx(theirs["Ra"], rel=1e-9)
    assert ours.total_um == pytest.approx(theirs["Rz"], rel=1e-9)


def test_a_slope_is_measured_with_its_uncertainty(height: HeightMap) -> None:
    row, column = np.mgrid[:60, :80].astype(np.float32)
    rng = np.random.default_rng(1)
    ramp = HeightMap((0.5 * column + rng.normal(0.0, 0.2, row.shape)).astype(np.float32), PITCH_UM)
    found = difference(ramp, (30.0, 10.0), (30.0, 60.0), 1.5)
    assert found.distance_um == pytest.approx(50.0 * PITCH_UM)
    assert found.dz_sigma_um is not None
    assert abs(found.dz_um - 25.0) < 3.0 * found.dz_sigma_um
    assert found.dz_sigma_um == pytest.approx(np.sqrt(2.0) * np.hypot(1.5, 0.2), rel=0.02)
    assert found.angle_deg == pytest.approx(np.degrees(np.arctan2(25.0, 1200.0)), abs=0.05)
    assert difference(ramp, (30.0, 10.0), (30.0, 60.0), None).dz_sigma_um is None
    assert np.isnan(difference(height, (21.0, 31.0), (60.0, 60.0), 1.0).dz_um)


def test_the_uncertainty_of_two_pixels_is_the_scatter_of_their_difference() -> None:
    """Heights are those of single pixels, and so is their noise."""
    rng = np.random.default_rng(2)
    noisy = HeightMap(rng.normal(0.0, 0.7, (60, 400)).astype(np.float32), PITCH_UM)
    found = [difference(noisy, (30.0, 5.0 + column), (10.0, 5.0 + column), 0.0) for column in range(390)]
    sigmas = [one.dz_sigma_um for one in found if one.dz_sigma_um is not None]
    assert np.mean(sigmas) == pytest.approx(np.std([one.dz_um for one in found]), rel=0.15)


def test_a_point_without_height_is_said_and_no_nan_is_printed(height: HeightMap) -> None:
    text = measure_text(height, (21.0, 31.0), (60.0, 60.0), 1.0)
    assert "no height at a point" in text
    assert "nan" not in text.lower()
    beside = measure_text(height, (19.0, 31.0), (60.0, 60.0), 1.0)
    assert "dz " in beside
    assert "nan" not in beside.lower()
