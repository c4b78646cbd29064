"""The stated σ against errors that are put in, and the level against skin whose rest is known."""

import msgspec
import numpy as np
import pytest

from device.surface import GradientField, HeightMap, surface_slopes
from host_sync.integration.datum import untouched_mask, zero_to_datum
from host_sync.integration.integrate import integrate
from host_sync.integration.zero_level import Datum, block_medians
from host_sync.uncertainty.calibration_uncertainty import CalibrationUncertainty
from host_sync.uncertainty.elevation import ElevationCorrection
from host_sync.uncertainty.height_error import (
    HeightUncertainty,
    height_draws,
    height_uncertainty,
    nonintegrable_residual,
    reduced_size,
    slope_draws,
    slope_sigma,
)
from host_sync.uncertainty.slope_error import SlopeError

SHAPE = (200, 256)
PITCH_UM = 10.0
FAR = ElevationCorrection(20.0, 80.0, 0.0)
"""Balls that stood 20 pixels high under lights far away."""


def bump() -> np.ndarray:
    """A plateau in the middle, flat skin around it; µm."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    distance = np.hypot(row - 100.0, column - 128.0)
    return 150.0 / (1.0 + np.exp((distance - 50.0) / 4.0))


def gradients_of(z_um: np.ndarray, noise: float, seed: int = 0) -> GradientField:
    q, p = np.gradient(z_um / PITCH_UM)
    random = np.random.default_rng(seed)
    p, q = (slope + noise * random.standard_normal(SHAPE) for slope in (p, q))
    ones = np.ones(SHAPE, np.float32)
    return GradientField(p.astype(np.float32), q.astype(np.float32), ones > 0, ones)


def error_of(pixel_deg: float, patch_deg: float, patch_px: float, gain: float = 0.0) -> SlopeError:
    """An error that is the same at every tilt."""
    return SlopeError((0.0, 60.0), (pixel_deg,) * 2, (patch_deg,) * 2, patch_px, FAR, ((gain, gain),))


def known_of(
    gradients: GradientField,
    error: SlopeError,
    scale_share: float = 0.0,
    shadow: tuple[np.ndarray, np.ndarray] | None = None,
) -> HeightUncertainty:
    height, datum = HeightMap(bump().astype(np.float32), PITCH_UM), Datum(bump() < 1e-4, 0.0, 0.0, 0.5)
    level = np.zeros(SHAPE, np.float32)
    return height_uncertainty(height, gradients, level, error, datum, scale_share, shadow=shadow)


def sigma_of(gradients: GradientField, error: SlopeError) -> np.ndarray:
    return known_of(gradients, error).sigma_um


def test_the_level_is_the_untouched_skin_not_the_plateau() -> None:
    gradients = gradients_of(bump(), 0.01)
    at_rest = untouched_mask(gradients)
    assert at_rest[:20].mean() > 0.9
    assert not at_rest[95:105, 120:136].any()
    height = zero_to_datum(HeightMap(bump().astype(np.float32) + np.float32(77.0), PITCH_UM), at_rest)
    assert abs(float(np.median(height.z_um[:20]))) < 1.0


def test_without_flat_skin_every_pixel_gives_the_level() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert untouched_mask(gradients_of(3.0 * PITCH_UM * (column + row), 0.01)).all()


def test_sigma_is_the_spread_of_heights_under_pixel_noise() -> None:
    noise = 0.05
    heights = []
    for seed in range(12):
        gradients = gradients_of(0.0 * bump(), noise, seed)
        height, _ = integrate(gradients, PITCH_UM)
        heights.append(zero_to_datum(height, gradients.valid).z_um)
    spread = float(np.std(heights, axis=0).mean())
    stated = float(sigma_of(gradients_of(0.0 * bump(), 0.0), error_of(np.degrees(noise), 0.0, 5.0, 0.0)).mean())
    assert stated == pytest.approx(spread, rel=0.35)


def test_errors_of_a_patch_bend_the_height_more_than_errors_of_a_pixel() -> None:
    gradients = gradients_of(bump(), 0.0)
    pixel = sigma_of(gradients, error_of(2.0, 0.0, 8.0, 0.0))
    patch = sigma_of(gradients, error_of(0.0, 2.0, 8.0, 0.0))
    assert patch.mean() > 4.0 * pixel.mean()


def test_slopes_that_belong_to_no_surface_betray_themselves() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    swirl = np.exp(-((row - 100.0) ** 2 + (column - 128.0) ** 2) / 800.0) / 20.0
    clean = gradients_of(bump(), 0.0)
    false = GradientField(
        clean.p - (swirl * (row - 100.0)).astype(np.float32) * 0.05,
        clean.q + (swirl * (column - 128.0)).astype(np.float32) * 0.05,
        clean.valid,
        clean.weight,
    )
    betrayed = []
    for gradients in (clean, false):
        height, _ = integrate(gradients, PITCH_UM)
        betrayed.append(nonintegrable_residual(gradients, *surface_slopes(height)))
    assert betrayed[1][100, 128] > 10.0 * betrayed[0][100, 128]
    assert betrayed[1][100, 128] > 5.0 * betrayed[1][10, 10]


def test_an_invalid_pixel_has_no_sigma() -> None:
    gradients = gradients_of(bump(), 0.0)
    gradients.valid[3, 4] = False
    sigma = sigma_of(gradients, error_of(1.0, 0.5, 8.0, 0.0))
    assert np.isnan(sigma[3, 4])
    assert np.isfinite(sigma[10, 10])


def test_an_error_of_scale_grows_with_the_height() -> None:
    sigma = sigma_of(gradients_of(bump(), 0.0), error_of(0.0, 0.0, 8.0, 0.02))
    np.testing.assert_allclose(sigma, 0.02 * np.abs(bump()), rtol=0.02, atol=5e-3)


def test_skin_lower_than_the_balls_apexes_is_less_sure_under_near_lights() -> None:
    error = error_of(0.0, 0.0, 8.0)
    near = msgspec.structs.replace(error, elevation=ElevationCorrection(20.0, 20.0, 0.002))
    gradients = gradients_of(bump(), 0.0)
    assert np.nanmax(sigma_of(gradients, error)) < 1e-3
    sigma = sigma_of(gradients, near)
    plateau = sigma[95:105, 120:136]
    assert 0.004 * bump().max() < plateau.mean() < 0.05 * bump().max()
    assert sigma[:10].max() < 0.2 * plateau.mean()


def test_the_zero_is_not_known_better_than_resting_skin_is_flat() -> None:
    gradients, at_rest = gradients_of(bump(), 0.0), np.zeros(SHAPE, bool)
    at_rest[:20] = True
    uneven_um = np.where(np.arange(SHAPE[1]) < SHAPE[1] // 2, -3.0, 3.0).astype(np.float32)
    height = HeightMap(np.broadcast_to(uneven_um, SHAPE), PITCH_UM)
    flat = np.zeros(SHAPE, np.float32)
    datum = Datum(at_rest, 0.0, float(np.abs(block_medians(height.z_um, at_rest)).mean()), 0.1)
    known = height_uncertainty(height, gradients, flat, error_of(0.0, 0.0, 8.0), datum)
    assert 2.0 < known.sigma_um.min() <= known.sigma_um.max() < 4.0


def test_uneven_skin_that_errors_of_slopes_account_for_counts_once() -> None:
    gradients, error = gradients_of(bump(), 0.0), error_of(0.0, 0.5, 8.0)
    height, flat, at_rest = HeightMap(bump().astype(np.float32), PITCH_UM), np.zeros(SHAPE, np.float32), bump() < 1e-6

    def sigma(spread_um: float) -> np.ndarray:
        datum = Datum(at_rest, 0.0, spread_um, 0.5)
        return height_uncertainty(height, gradients, flat, error, datum).sigma_um

    drawn = height_uncertainty(height, gradients, flat, error, Datum(at_rest, 0.0, 0.0, 0.5)).samples_um
    drawn_um = float(np.sqrt(np.mean([np.square(block_medians(sample, at_rest)).mean() for sample in drawn])))
    assert drawn_um > 0.1
    np.testing.assert_allclose(sigma(0.95 * drawn_um), sigma(0.0), rtol=1e-6)
    assert sigma(3.0 * drawn_um).min() > 2.0 * sigma(0.0).min()


def test_a_hidden_light_leaves_the_whole_object_in_doubt_beside_it() -> None:
    ramp = np.zeros(SHAPE, np.float32)
    ramp[:, 60:70] = 0.02
    gradients, error = gradients_of(bump(), 0.0), error_of(0.0, 0.0, 8.0)
    known = known_of(gradients, error, shadow=(ramp, 0.0 * ramp))
    rise_um = 0.02 * 10.0 * PITCH_UM
    drawn_um = np.abs(known.samples_um[:, 100, 100] - known.samples_um[:, 100, 30])
    assert 0.7 * rise_um < np.sqrt((drawn_um**2).mean()) < 1.3 * rise_um
    assert known_of(gradients, error).sigma_um[100, 100] < 0.1 * rise_um


def test_an_unsure_scale_of_the_pixel_pitch_counts_as_well() -> None:
    known = known_of(gradients_of(bump(), 0.0), error_of(0.0, 0.0, 8.0, 0.03), scale_share=0.04)
    np.testing.assert_allclose(known.sigma_um, 0.05 * np.abs(bump()), rtol=0.01, atol=5e-3)


def test_the_draws_spread_as_sigma_says() -> None:
    known = known_of(gradients_of(bump(), 0.0), error_of(1.0, 0.5, 6.0, 0.02))
    spread = np.sqrt((known.samples_um**2).mean(axis=0))
    assert known.samples_um.shape[1:] == SHAPE
    assert np.median(spread / known.sigma_um) == pytest.approx(1.0, abs=0.15)


def test_numbers_drawn_before_give_the_samples_of_those_drawn_within() -> None:
    gradients, error = gradients_of(bump(), 0.0), error_of(1.0, 0.5, 6.0, 0.02)
    ramp = np.full(SHAPE, 0.01, np.float32)
    height, datum = HeightMap(bump().astype(np.float32), PITCH_UM), Datum(bump() < 1e-4, 0.0, 0.0, 0.5)
    surface = height, gradients, 0.0 * ramp, error, datum
    replicas = CalibrationUncertainty(*(np.stack([part, -part, ramp]) for part in (ramp, 2.0 * ramp)))
    within = height_uncertainty(*surface, calibration=replicas, shadow=(ramp, ramp))
    draws = height_draws(error, SHAPE, replicas, (ramp, ramp))
    of_shadow_and_replicas = slope_draws(error, reduced_size(SHAPE), SHAPE[1], fields=1 + 3)
    np.testing.assert_array_equal(draws.shared, of_shadow_and_replicas.shared)
    before = height_uncertainty(*surface, calibration=replicas, shadow=(ramp, ramp), draws=draws)
    np.testing.assert_array_equal(before.samples_um, within.samples_um)
    np.testing.assert_array_equal(before.sigma_um, within.sigma_um)


def test_slopes_are_less_sure_where_the_skin_is_steep_or_the_colour_strange() -> None:
    p = np.full(SHAPE, 1.0, np.float32)
    weight = np.ones(SHAPE, np.float32)
    weight[:, :100] = 0.04
    gradients = GradientField(p, 0.0 * p, weight > 0, weight)
    error = SlopeError((0.0, 45.0), (0.0, 0.0), (0.5, 1.0), 8.0, FAR, ())
    sigma = slope_sigma(gradients, p, 0.0 * p, 0.0 * p, error)
    assert sigma[50, 200] == pytest.approx(2.0 * np.radians(1.0), rel=1e-3)
    assert sigma[50, 50] == pytest.approx(5.0 * sigma[50, 200], rel=1e-3)
