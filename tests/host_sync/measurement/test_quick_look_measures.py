"""Roughness and differences read on the device agree with the workstation's on the same map."""

import re

import numpy as np
import pytest

from device.quick_look.measures import areal_roughness, difference, levelled, line_between, line_roughness, mean_line
from device.surface import HeightMap
from device.tui.drawing.text import measure_text
from host_sync.filters.form import PolynomialForm
from host_sync.filters.gaussian_regression import profile_mean
from host_sync.iso25178.areal_parameters import height_parameters
from host_sync.measurement.parameter_measurands import ProfileMeasurand
from host_sync.measurement.recipe import ProfileTable

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
    end_um = 239.0 * PITCH_UM
    table = ProfileTable(name="line", from_um=(0.0, row * PITCH_UM), to_um=(end_um, row * PITCH_UM), l_filter_um=800.0)
    theirs = ProfileMeasurand(table, height).values(height.z_um)
    assert ours.mean_um == pytest.approx(theirs["Ra"], rel=0.01)
    assert ours.total_um == pytest.approx(theirs["Rz"], rel=0.01)


def test_roughness_is_that_of_the_texture_and_not_of_the_form() -> None:
    place = PITCH_UM * np.arange(250)
    texture = 2.0 * np.sin(2.0 * np.pi * place / 160.0)
    for form in (0.05 * place, 1e-5 * (place - 3000.0) ** 2, 30.0 * np.sin(2.0 * np.pi * place / 12000.0)):
        found = line_roughness(texture + form, PITCH_UM)
        assert found.cutoff_um == 800.0
        assert found.mean_um == pytest.approx(4.0 / np.pi, rel=0.03)
        assert found.total_um == pytest.approx(4.0, rel=0.05)
        smooth = line_roughness(form, PITCH_UM)
        assert np.isnan(smooth.mean_um) or 2.0 * smooth.mean_um <= smooth.total_um < 0.3


def test_half_of_a_wave_as_long_as_the_cut_off_is_transmitted() -> None:
    place = PITCH_UM * np.arange(250)
    found = line_roughness(np.sin(2.0 * np.pi * place / 800.0), PITCH_UM)
    assert found.total_um == pytest.approx(1.0, rel=0.02)


def test_too_few_pixels_or_cut_offs_give_the_line_itself() -> None:
    coarse = line_roughness(np.sin(np.arange(40.0)), 50.0)  # six times 0.25 mm, in five pixels each
    assert coarse.cutoff_um is None
    short = line_roughness(np.sin(np.arange(160.0)), PITCH_UM)  # five times 0.8 mm, without run-ups
    assert short.cutoff_um != 800.0
    assert coarse.total_um >= 2.0 * coarse.mean_um


def test_roughness_states_its_uncertainty() -> None:
    rng = np.random.default_rng(3)
    place = PITCH_UM * np.arange(250)
    texture = 2.0 * np.sin(2.0 * np.pi * place / 160.0)
    assert line_roughness(texture, PITCH_UM).mean_sigma_um is None
    trials = [line_roughness(texture + rng.normal(0.0, 0.4, place.size), PITCH_UM, 0.4) for _ in range(20)]
    for one in trials:
        assert one.mean_sigma_um is not None
        assert one.total_sigma_um is not None
        assert abs(one.mean_um - 4.0 / np.pi) < 2.0 * one.mean_sigma_um
        assert abs(one.total_um - 4.0) < 2.0 * one.total_sigma_um
    flat = line_roughness(rng.normal(0.0, 0.4, place.size), PITCH_UM, 0.4)
    assert flat.mean_sigma_um is not None
    assert flat.mean_um <= 2.0 * flat.mean_sigma_um
    row, column = np.mgrid[:60, :300].astype(np.float32)
    words = measure_text(HeightMap(np.sin(column) + 0.0 * row, PITCH_UM), (30.0, 0.0), (30.0, 299.0), 0.1)
    assert re.search(r"Ra \d\.\d\d ± \d\.\d\d Rz \d\.\d ± \d\.\d µm \(cut-off 0.8 mm\)", words)


def test_a_large_height_is_no_surer_than_the_heights_of_untouched_skin() -> None:
    steps = np.where(np.arange(96) % 32 < 16, 0.0, 240.0) * np.ones((64, 1))
    found = areal_roughness(steps.astype(np.float32), 0.5)
    assert found.mean_sigma_um is not None
    assert found.total_sigma_um is not None
    assert found.mean_sigma_um >= 0.3
    assert found.total_sigma_um >= 0.7


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
