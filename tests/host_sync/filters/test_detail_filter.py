"""The detail filter: half of a sinusoid at its nesting index, tilts untouched everywhere, holes that bend nothing."""

from __future__ import annotations

import numpy as np
import pytest

from device.surface import HeightMap
from host_sync.errors import FilterError
from host_sync.filters.form import DetailBand, detail
from host_sync.filters.gaussian_regression import gaussian_mean
from host_sync.render.picture_file import exaggeration

PITCH_UM = 4.0
SIZE = 240


def wave(period_px: float, angle_rad: float = 0.0) -> np.ndarray:
    row, column = np.mgrid[:SIZE, :SIZE]
    across = column * np.cos(angle_rad) + row * np.sin(angle_rad)
    return np.cos(2.0 * np.pi / period_px * across).astype(np.float32)


def kept(found: np.ndarray, true: np.ndarray) -> float:
    inner = (slice(80, 160), slice(80, 160))
    return float((found[inner] * true[inner]).sum() / (true[inner] ** 2).sum())


@pytest.mark.parametrize("angle", [0.0, 0.6, np.pi / 2])
@pytest.mark.parametrize("period", [8.0, 20.0, 40.0])
def test_half_of_a_sinusoid_passes_at_the_nesting_index(period: float, angle: float) -> None:
    true = wave(period, angle)
    assert kept(gaussian_mean(true, period), true) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("share", [0.5, 2.0, 3.0])
def test_transmission_is_that_of_the_standard(share: float) -> None:
    true = wave(20.0)
    expected = np.exp(-np.pi * (np.sqrt(np.log(2.0) / np.pi) * share) ** 2)
    assert kept(gaussian_mean(true, 20.0 * share), true) == pytest.approx(expected, abs=0.01)


def test_the_band_passes_what_lies_between_and_halves_at_its_ends() -> None:
    band = DetailBand(s_um=5.0 * PITCH_UM, l_um=60.0 * PITCH_UM)
    shares = {
        period: kept(detail(HeightMap(wave(period), PITCH_UM), band).z_um, wave(period)) for period in (5.0, 17.0)
    }
    assert shares[5.0] == pytest.approx(0.5, abs=0.01)
    assert shares[17.0] > 0.9
    only_long = DetailBand(s_um=None, l_um=40.0 * PITCH_UM)
    assert kept(detail(HeightMap(wave(40.0), PITCH_UM), only_long).z_um, wave(40.0)) == pytest.approx(0.5, abs=0.01)


def test_a_tilt_holds_no_detail_up_to_the_border_and_beside_holes() -> None:
    row, column = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    tilted = 1000.0 + 0.3 * column - 0.2 * row
    tilted[100:140, 60:90] = np.nan
    found = detail(HeightMap(tilted, PITCH_UM), DetailBand(None, 50.0 * PITCH_UM)).z_um
    np.testing.assert_array_equal(np.isnan(found), np.isnan(tilted))
    assert np.nanmax(np.abs(found)) < 2e-2
    assert np.nanmax(np.abs(tilted - np.nanmean(tilted))) > 20.0


def test_detail_beside_a_hole_is_what_it_is_without_the_hole() -> None:
    whole = wave(6.0)
    torn = whole.copy()
    torn[:, 120:] = np.nan
    band = DetailBand(None, 60.0 * PITCH_UM)
    difference = detail(HeightMap(torn, PITCH_UM), band).z_um - detail(HeightMap(whole, PITCH_UM), band).z_um
    assert np.nanmax(np.abs(difference)) < 0.1


def test_a_lone_pixel_and_an_empty_map_stay_what_they_are() -> None:
    empty = np.full((20, 20), np.nan, np.float32)
    assert np.isnan(gaussian_mean(empty, 5.0)).all()
    empty[4, 5] = 7.0
    assert gaussian_mean(empty, 5.0)[4, 5] == pytest.approx(7.0)


@pytest.mark.parametrize(("s_um", "l_um"), [(0.0, None), (None, float("nan")), (800.0, 8.0), (5.0, 5.0), (-1.0, 3.0)])
def test_indices_that_leave_nothing_are_refused(s_um: float | None, l_um: float | None) -> None:
    with pytest.raises(FilterError, match="-filter"):
        DetailBand(s_um, l_um)


def test_shallow_detail_is_exaggerated_and_steep_is_not() -> None:
    assert exaggeration(HeightMap(0.01 * wave(10.0), PITCH_UM)) > 10.0
    assert exaggeration(HeightMap(50.0 * wave(10.0), PITCH_UM)) == 1.0
