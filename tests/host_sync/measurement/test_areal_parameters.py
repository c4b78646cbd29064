"""Areal parameters against closed forms: sinusoid, Gaussian noise, tilted cells, plateaus; masks change nothing."""

import numpy as np
import pytest

from host_sync.iso25178.areal_parameters import (
    Autocorrelation,
    MaterialRatioCurve,
    decay,
    functional_parameters,
    height_parameters,
    hybrid_parameters,
    texture_direction_deg,
)
from host_sync.iso25178.power_spectrum import RadialSpectrum

PITCH_UM = 5.0
AMPLITUDE_UM = 3.0


def wave(period_px: float, size: int = 400, angle_rad: float = 0.0) -> np.ndarray:
    row, column = np.mgrid[:size, :size]
    across = column * np.cos(angle_rad) - row * np.sin(angle_rad)
    return (AMPLITUDE_UM * np.sin(2.0 * np.pi * across / period_px + 0.1)).astype(np.float32)


def masked(z_um: np.ndarray, share: float = 0.3, seed: int = 0) -> np.ndarray:
    torn = z_um.copy()
    torn[np.random.default_rng(seed).random(z_um.shape) < share] = np.nan
    return torn


@pytest.mark.parametrize("tear", [lambda z: z, masked])
def test_heights_of_a_sinusoid(tear) -> None:
    found = height_parameters(tear(wave(50.0) + np.float32(812.0)))
    assert found["Sa"] == pytest.approx(2.0 * AMPLITUDE_UM / np.pi, rel=3e-3)
    assert found["Sq"] == pytest.approx(AMPLITUDE_UM / np.sqrt(2.0), rel=3e-3)
    assert found["Sz"] == pytest.approx(2.0 * AMPLITUDE_UM, rel=3e-3)
    assert found["Sp"] == pytest.approx(AMPLITUDE_UM, rel=4e-3)
    assert found["Sv"] == pytest.approx(AMPLITUDE_UM, rel=4e-3)
    assert found["Ssk"] == pytest.approx(0.0, abs=0.01)
    assert found["Sku"] == pytest.approx(1.5, rel=3e-3)


def test_skewness_and_kurtosis_of_an_exponential_and_a_normal_surface() -> None:
    random = np.random.default_rng(1)
    found = height_parameters(random.exponential(1.0, (1000, 1000)).astype(np.float32))
    assert found["Ssk"] == pytest.approx(2.0, rel=0.03)
    assert found["Sku"] == pytest.approx(9.0, rel=0.1)
    assert height_parameters(random.standard_normal((1000, 1000)).astype(np.float32))["Sku"] == pytest.approx(
        3.0, rel=0.01
    )


@pytest.mark.parametrize("tear", [lambda z: z, masked])
def test_slope_of_a_sinusoid_is_that_of_its_differences(tear) -> None:
    period = 20.0
    k = 2.0 * np.pi / (period * PITCH_UM)
    difference = np.sinc(1.0 / period)  # a difference over one pixel sees so much of a slope
    found = hybrid_parameters(tear(wave(period)), PITCH_UM)
    assert found["Sdq"] == pytest.approx(AMPLITUDE_UM * k / np.sqrt(2.0) * difference, rel=0.01)


def test_area_of_a_tilted_plane_and_of_a_cone_of_cells() -> None:
    row, column = np.mgrid[:50, :60]
    tilted = ((0.6 * column + 0.8 * row) * PITCH_UM).astype(np.float32)
    found = hybrid_parameters(tilted, PITCH_UM)
    assert found["Sdr"] == pytest.approx(100.0 * (np.sqrt(2.0) - 1.0), rel=1e-5)
    assert found["Sdq"] == pytest.approx(1.0, rel=1e-5)
    torn = tilted.copy()
    torn[10:20, 5:30] = np.nan
    assert hybrid_parameters(torn, PITCH_UM) == pytest.approx(found, rel=1e-5)


def test_a_surface_without_pixels_has_no_parameters() -> None:
    empty = np.full((20, 20), np.nan, np.float32)
    for found in (height_parameters(empty), hybrid_parameters(empty, 1.0), functional_parameters(empty)):
        assert all(np.isnan(value) for value in found.values())
    assert np.isnan(decay(Autocorrelation(np.isfinite(empty)).of(empty)).shortest_px)


def test_a_sinusoid_falls_along_its_waves_only_and_its_direction_is_stated() -> None:
    period = 40.0
    for angle_deg in (0.0, 30.0, -60.0):
        z_um = wave(period, 300, np.radians(angle_deg))
        correlation = Autocorrelation(np.isfinite(z_um)).of(z_um)
        fallen = decay(correlation)
        assert fallen.shortest_px == pytest.approx(period * np.arccos(0.2) / (2.0 * np.pi), rel=0.02)
        assert not fallen.reached
        assert texture_direction_deg(correlation) == pytest.approx(angle_deg, abs=1.0)


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_noise_smoothed_unequally_has_its_widths_and_their_ratio(share: float) -> None:
    random = np.random.default_rng(3)
    frequency = [np.fft.fftfreq(600) * 2.0 * np.pi for _ in range(2)]
    down_px, across_px = 4.0, 10.0
    transfer = np.exp(-0.5 * ((down_px * frequency[0][:, None]) ** 2 + (across_px * frequency[1]) ** 2))
    z_um = np.fft.ifft2(np.fft.fft2(random.standard_normal((600, 600))) * transfer).real.astype(np.float32)
    z_um = masked(z_um, share)
    fallen = decay(Autocorrelation(np.isfinite(z_um)).of(z_um))
    # Of noise blurred by σ the correlation is exp(-d² / (4 σ²)).
    expected = 2.0 * np.sqrt(np.log(5.0))
    assert fallen.reached
    assert fallen.shortest_px == pytest.approx(down_px * expected, rel=0.06)
    assert fallen.shortest_px / fallen.longest_px == pytest.approx(down_px / across_px, rel=0.08)


@pytest.mark.parametrize("tear", [lambda z: z, masked])
def test_the_material_ratio_of_an_even_distribution_is_a_straight_line(tear) -> None:
    heights = np.random.default_rng(4).permutation(np.linspace(-5.0, 5.0, 250_000)).astype(np.float32)
    found = functional_parameters(tear(heights.reshape(500, 500)))
    assert found["Sk"] == pytest.approx(10.0, rel=0.01)
    assert found["Spk"] == pytest.approx(0.0, abs=0.05)
    assert found["Svk"] == pytest.approx(0.0, abs=0.05)
    # A ramp of height H holds p² H / 2 of material over the height at p.
    assert found["Vmp"] == pytest.approx(10.0 * 0.1**2 / 2.0, rel=0.02)
    assert found["Vmc"] == pytest.approx(10.0 * (0.8**2 - 0.1**2) / 2.0, rel=0.02)
    assert found["Vvc"] == pytest.approx(10.0 * (0.9**2 - 0.2**2) / 2.0, rel=0.02)
    assert found["Vvv"] == pytest.approx(10.0 * 0.2**2 / 2.0, rel=0.02)
    assert found["Sxp"] == pytest.approx(10.0 * 0.475, rel=0.01)


def test_peaks_and_valleys_stand_out_of_the_core() -> None:
    core = np.linspace(1.0, -1.0, 80_000)
    peaks, valleys = np.linspace(7.0, 1.0, 10_000), np.linspace(-1.0, -4.0, 10_000)
    found = functional_parameters(np.concatenate([peaks, core, valleys]).astype(np.float32)[None])
    assert found["Sk"] == pytest.approx(2.5, rel=0.01)  # the core's line, from 0 to 100 %
    assert found["Smr1"] == pytest.approx(100.0 * 0.1 * (7.0 - 1.25) / 6.0, rel=0.01)
    assert found["Spk"] == pytest.approx(7.0 - 1.25, rel=0.02)
    assert found["Svk"] == pytest.approx(4.0 - 1.25, rel=0.02)
    assert found["Smr2"] == pytest.approx(90.0 + 10.0 * 0.25 / 3.0, rel=0.01)


def test_ratio_and_height_are_each_others_inverse() -> None:
    curve = MaterialRatioCurve.of(np.random.default_rng(5).standard_normal((300, 300)).astype(np.float32))
    for share in (0.05, 0.4, 0.9):
        assert curve.share(curve.height_um(share)) == pytest.approx(share, abs=1e-4)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_the_spectrum_adds_up_to_the_mean_square_and_peaks_at_the_period(share: float) -> None:
    z_um = masked(wave(25.0), share)
    found = RadialSpectrum(np.isfinite(z_um), PITCH_UM).of(z_um)
    peak = found.per_um[int(found.density_um3.argmax())]
    assert peak == pytest.approx(1.0 / (25.0 * PITCH_UM), rel=0.13)
    power = np.sum(found.density_um3 * found.width_per_um)
    assert power == pytest.approx(np.nanvar(z_um), rel=0.06)


def test_a_surface_without_relief_has_no_direction() -> None:
    assert np.isnan(texture_direction_deg(np.full((41, 21), np.nan, np.float32)))
