"""Lines, profile parameters, steps and grooves, distances, angles and volumes with known answers."""

import numpy as np
import pytest

from host_sync.errors import MeasurementError
from host_sync.filters.gaussian_regression import profile_mean
from host_sync.measurement.geometry import Region, SkinPlaces, bend_deg, between_places, between_planes_deg, pit_volumes
from host_sync.profile.profile_line import Line, Profile, profile_along, profile_parameters
from host_sync.profile.step_height import StepEdges, find_edges, step_height_um

PITCH_UM = 4.0


def test_a_line_across_a_plane_rises_as_the_plane_does() -> None:
    row, column = np.mgrid[:100, :120]
    z_um = (0.5 * column * PITCH_UM - 0.2 * row * PITCH_UM).astype(np.float32)
    line = Line((40.0, 40.0), (340.0, 340.0), 20.0)
    profile = profile_along(z_um, PITCH_UM, line)
    along = (0.5 - 0.2) / np.sqrt(2.0)
    np.testing.assert_allclose(np.diff(profile.z_um), along * PITCH_UM, atol=1e-4)
    assert profile.z_um.size * PITCH_UM == pytest.approx(line.length_um, abs=2.0 * PITCH_UM)


def test_holes_stay_holes_and_a_wide_line_bridges_small_ones() -> None:
    z_um = np.zeros((60, 100), np.float32)
    z_um[30, 50] = np.nan
    thin = profile_along(z_um, 1.0, Line((5.0, 30.0), (95.0, 30.0)))
    assert np.isnan(thin.z_um).sum() == 1
    wide = profile_along(z_um, 1.0, Line((5.0, 30.0), (95.0, 30.0), 8.0))
    assert np.isfinite(wide.z_um).all()


def test_a_wide_line_stays_on_the_line_where_one_side_of_it_is_masked() -> None:
    row, column = np.mgrid[:80, :200]
    z_um = (0.1 * row * PITCH_UM + 30.0 * (column >= 100)).astype(np.float32)
    z_um[41:, 60:140] = np.nan
    profile = profile_along(z_um, PITCH_UM, Line((40.0, 160.0), (760.0, 160.0), 120.0))
    truth = 16.0 + 30.0 * (np.arange(10, 191) >= 100)
    np.testing.assert_allclose(profile.z_um, truth, atol=1e-3)


@pytest.mark.parametrize("end", [(4000.0, 10.0), (-30.0, 5.0)])
def test_a_line_that_leaves_the_field_is_refused(end: tuple[float, float]) -> None:
    with pytest.raises(MeasurementError, match="outside the field"):
        profile_along(np.zeros((60, 100), np.float32), 1.0, Line((5.0, 30.0), end))


def sine(period: float, amplitude: float = 2.0, size: int = 1000) -> np.ndarray:
    return amplitude * np.sin(2.0 * np.pi * (np.arange(size) + 0.3) / period)


@pytest.mark.parametrize("torn", [False, True])
def test_a_sinusoid_has_its_parameters(torn: bool) -> None:
    z_um = sine(50.0)
    if torn:
        z_um[400:450] = np.nan
    found = profile_parameters(Profile(z_um, PITCH_UM), 5, "R")
    assert found["Ra"] == pytest.approx(4.0 / np.pi, rel=2e-3)
    assert found["Rq"] == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert found["Rz"] == pytest.approx(4.0, rel=2e-3)
    assert found["Rt"] == pytest.approx(4.0, rel=2e-3)
    assert found["Rsk"] == pytest.approx(0.0, abs=1e-3)
    assert found["Rku"] == pytest.approx(1.5, rel=1e-3)
    assert found["RSm"] == pytest.approx(50.0 * PITCH_UM, rel=2e-3)
    assert found["Rdq"] == pytest.approx(2.0 * 2.0 * np.pi / (50.0 * PITCH_UM) / np.sqrt(2.0), rel=3e-3)


def test_ripple_on_a_wave_parts_no_elements() -> None:
    found = profile_parameters(Profile(sine(100.0) + sine(7.0, 0.05), 1.0), 5, "R")
    assert found["RSm"] == pytest.approx(100.0, rel=0.01)


def test_the_profile_filter_halves_at_its_index_and_passes_a_tilt_at_the_ends() -> None:
    inner = slice(300, 700)
    wave = sine(60.0)
    kept = (profile_mean(wave, 60.0)[inner] * wave[inner]).sum() / (wave[inner] ** 2).sum()
    assert kept == pytest.approx(0.5, abs=0.002)
    tilt = 0.3 * np.arange(1000.0) + 5.0
    tilt[200:230] = np.nan
    np.testing.assert_allclose(profile_mean(tilt, 80.0), tilt, atol=1e-6)


def step_profile(height: float, tilt: float, size: int = 400) -> Profile:
    x = np.arange(size) - size / 2.0
    return Profile(height * (np.tanh(x / 3.0) + 1.0) / 2.0 + tilt * x * PITCH_UM, PITCH_UM)


@pytest.mark.parametrize("tilt", [0.0, 0.02])
def test_a_step_has_its_height_under_a_tilt(tilt: float) -> None:
    profile = step_profile(-25.0, tilt)
    edges = find_edges(profile, "step")
    assert edges.places_um[0] == pytest.approx(800.0, abs=40.0)
    assert step_height_um(profile, edges) == pytest.approx(-25.0, abs=0.05)


@pytest.mark.parametrize("depth", [-10.0, 14.0])
def test_a_groove_or_ridge_has_its_depth_under_a_tilt_and_a_hole(depth: float) -> None:
    x = np.arange(600) - 310.0
    z_um = depth * (np.abs(x) < 60.5) + 0.03 * x
    z_um[305:309] = np.nan
    profile = Profile(z_um, PITCH_UM)
    edges = find_edges(profile, "groove")
    assert edges.places_um == pytest.approx((249.5 * PITCH_UM, 370.5 * PITCH_UM), abs=1.0)
    assert step_height_um(profile, edges) == pytest.approx(depth, abs=1e-6)


def test_a_step_without_room_is_refused() -> None:
    with pytest.raises(MeasurementError, match="fewer than 3 valid samples"):
        step_height_um(step_profile(5.0, 0.0), StepEdges("step", (4.0,)))
    with pytest.raises(MeasurementError, match="no groove"):
        find_edges(Profile(np.zeros(100), 1.0), "groove")


def test_distances_and_angles_of_a_roof() -> None:
    row, column = np.mgrid[:100, :201]
    z_um = (-0.5 * np.abs(column - 100) * PITCH_UM + 0.0 * row).astype(np.float32)
    found = between_places(z_um, SkinPlaces(PITCH_UM), np.array([80.0, 200.0]), np.array([240.0, 200.0]))
    assert found["along the skin"] == pytest.approx(160.0)
    assert found["in height"] == pytest.approx(80.0, abs=0.01)
    assert found["in space"] == pytest.approx(np.hypot(160.0, 80.0), abs=0.01)
    assert found["slope angle"] == pytest.approx(np.degrees(np.arctan(0.5)), abs=0.01)
    left, right = (Region(a, 40.0, b, 300.0).cut(z_um, PITCH_UM) for a, b in ((20.0, 380.0), (420.0, 780.0)))
    angle_deg = between_planes_deg(left, right, (SkinPlaces(PITCH_UM), SkinPlaces(PITCH_UM)))
    assert angle_deg == pytest.approx(2.0 * np.degrees(np.arctan(0.5)), abs=0.01)


@pytest.mark.parametrize("masked", [0, 2])
def test_heights_of_a_distance_are_those_of_its_very_ends(masked: int) -> None:
    column = np.arange(60) * np.ones((40, 1))
    z_um = (column * PITCH_UM).astype(np.float32)  # 45 degrees
    z_um[:, 5 : 5 + masked] = np.nan
    for start, end in ((0.0, 100.0), (17.5, 71.8), (33.0, 80.0)):
        found = between_places(z_um, SkinPlaces(PITCH_UM), np.array([start, 80.0]), np.array([end, 80.0]))
        assert found["in height"] == pytest.approx(end - start, abs=1e-3)


def test_a_face_that_is_not_flat_leans_apart_from_half_to_half() -> None:
    row, column = np.mgrid[:101, :101] * PITCH_UM
    tilted = (0.3 * column - 0.2 * row).astype(np.float32)
    assert bend_deg(tilted, SkinPlaces(PITCH_UM)) == pytest.approx(0.0, abs=0.01)
    radius_um = 2000.0
    for across in (column, row):
        cylinder = np.sqrt(radius_um**2 - (across - 200.0) ** 2).astype(np.float32)
        apart = np.degrees(2.0 * np.arcsin(100.0 / radius_um))
        assert bend_deg(cylinder, SkinPlaces(PITCH_UM)) == pytest.approx(apart, rel=0.02)
    assert np.isnan(bend_deg(np.full((4, 4), np.nan, np.float32), SkinPlaces(PITCH_UM)))


def test_the_volume_of_a_hollow_under_a_tilted_face() -> None:
    row, column = np.mgrid[:200, :200] * PITCH_UM
    depth, radius = 20.0, 200.0
    square = ((column - 400.0) ** 2 + (row - 400.0) ** 2) / radius**2
    z_um = (-depth * np.maximum(1.0 - square, 0.0) + 0.05 * column).astype(np.float32)
    found = pit_volumes(z_um, SkinPlaces(PITCH_UM), 10)
    assert found["void volume"] == pytest.approx(np.pi * radius**2 * depth / 2.0, rel=2e-3)
    assert found["largest depth"] == pytest.approx(depth, rel=1e-3)
    assert found["material volume"] == pytest.approx(0.0, abs=1.0)


def test_a_region_outside_is_refused() -> None:
    with pytest.raises(MeasurementError, match="region"):
        Region(5000.0, 0.0, 6000.0, 10.0).cut(np.zeros((50, 50), np.float32), 1.0)
