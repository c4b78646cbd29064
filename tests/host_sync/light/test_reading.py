"""Wrong slopes of an inverse map, corrected by the light model, under near lights of a renderer of its own."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matt_light import COLUMN, ROW, lamps_reach, matt_model, stated
from near_lamps import RADIUS_PX, SHAPE, NearLamps
from scipy.ndimage import gaussian_filter

from device.imaging.flat_field import NormalizedImage
from device.imaging.frame_light import FrameLight
from device.inverse_map.skin_at_rest import RestEvidence
from device.surface import GradientField
from host_sync.integration.integrate import integrate
from host_sync.kernels.cell_rows import WIDEST_CELLS
from host_sync.light.cells import SHADOW_WEIGHT
from host_sync.light.reading import CellCorrection, correct_slopes
from host_sync.uncertainty.elevation import ElevationCorrection
from host_sync.video.fine_pass import read_coarse

LAMP_PX = 180.0
LAMPS = NearLamps(LAMP_PX)
MODEL = matt_model(LAMP_PX)
LIGHT = stated(MODEL, MODEL)
HEIGHT_PX = 16.0
EVERYWHERE = np.ones(SHAPE, bool)
BALLS = ElevationCorrection(apex_px=15.0, radius_px=RADIUS_PX, nearness_per_px=1.0 / LAMP_PX)
PRIOR_SIGMA = 0.1
GAIN_SIGMA = 0.01
FEW_CELLS = 96
"""Along the columns, where a test searches in many rounds."""
ZERO = np.zeros(SHAPE)
DISTANCE = np.hypot(COLUMN - 0.5 * SHAPE[1], ROW - 0.5 * SHAPE[0])


def cone(flank: float) -> np.ndarray:
    """Return the elevation of a blunt cone on level skin, pixels."""
    return gaussian_filter(np.clip(HEIGHT_PX + flank * (30.0 - DISTANCE), 0.0, HEIGHT_PX), 1.0)


def field(p: np.ndarray, q: np.ndarray) -> GradientField:
    return GradientField(p.astype(np.float32), q.astype(np.float32), EVERYWHERE, np.ones(SHAPE, np.float32))


def seen_as_at_rest(image: NormalizedImage) -> GradientField:
    """Return the slopes that explain each pixel as if it stood where skin at rest does."""
    slope = np.zeros((2, *SHAPE))
    flat, wanted = LAMPS.flat_field(), image.values
    for _ in range(8):
        here = LAMPS.light(ZERO, *slope) / flat
        changes = [
            (LAMPS.light(ZERO, *(slope + np.reshape(step, (2, 1, 1)))) / flat - here) / 1e-4
            for step in ((1e-4, 0.0), (0.0, 1e-4))
        ]
        by = np.stack(changes, axis=-1)
        system = np.einsum("hwcj,hwck->hwjk", by, by) + 1e-6 * np.eye(2)
        gradient = np.einsum("hwcj,hwc->hwj", by, wanted - here)
        slope += np.moveaxis(np.linalg.solve(system, gradient[..., None])[..., 0], -1, 0)
    return field(*slope)


def shadowed(z_px: np.ndarray) -> tuple[NormalizedImage, np.ndarray]:
    """Return the image of a surface without the light that it hides, and which lamps reach it."""
    lit = lamps_reach(z_px, LAMPS)
    image = LAMPS.intensity(z_px)
    return replace(image, values=np.asarray(image.values * lit, np.float32)), lit


def noisy(image: NormalizedImage, gain: float | np.ndarray = 1.0) -> NormalizedImage:
    noise = 0.003 * np.random.default_rng(1).standard_normal(image.values.shape)
    return replace(image, values=np.asarray((image.values + noise) * gain, np.float32))


def height_px(gradients: GradientField) -> float:
    """Return how high the cone's top stands over the skin along the border."""
    z = integrate(gradients, 1.0)[0].z_um
    border = np.concatenate([z[:10].ravel(), z[-10:].ravel()])
    return float(np.median(z[DISTANCE < 25.0]) - np.median(border))


def evidence(moved: np.ndarray) -> RestEvidence:
    """Return evidence of rest where nothing moved, bool array of shape (H, W)."""
    cells = moved.reshape(SHAPE[0] // 8, 8, SHAPE[1] // 8, 8).any(axis=(1, 3))
    return RestEvidence(cells.astype(np.float32), np.ones_like(cells), FrameLight.unchanged(), GAIN_SIGMA)


def corrected(
    gradients: GradientField, image: NormalizedImage, rest: RestEvidence | None = None, cells_across: int = WIDEST_CELLS
) -> tuple[CellCorrection, GradientField]:
    found = correct_slopes(gradients, image, LIGHT, PRIOR_SIGMA, BALLS, rest=rest, cells_across=cells_across)
    after = replace(gradients, p=gradients.p.copy(), q=gradients.q.copy(), weight=gradients.weight.copy())
    found.apply(after)
    return found, after


def test_level_skin_at_rest_gains_nothing() -> None:
    found, _ = corrected(field(ZERO, ZERO), LAMPS.intensity(ZERO))
    np.testing.assert_allclose([found.p, found.q], 0.0, atol=1e-6)
    assert not found.shadow.any()
    assert found.has_rest


def test_slopes_that_a_map_shows_too_flat_become_right() -> None:
    z = cone(0.3)
    q, p = np.gradient(z)
    before = field(0.9 * p, 0.9 * q)
    _, after = corrected(before, LAMPS.intensity(z))
    assert height_px(before) < 0.93 * HEIGHT_PX
    assert height_px(after) == pytest.approx(HEIGHT_PX, rel=0.01)


def test_an_object_that_stands_high_under_near_light_keeps_its_slopes() -> None:
    """Shown as if it were at rest, skin 24 px up under lamps at 180 px is a seventh too steep."""
    plate = 24.0 * gaussian_filter(np.clip((120.0 - DISTANCE) / 60.0, 0.0, 1.0), 6.0)
    z = plate + 1.5 * np.cos(COLUMN / 8.0) * gaussian_filter((DISTANCE < 45.0).astype(float), 6.0)
    q, p = np.gradient(z)
    image = LAMPS.intensity(z)
    before = seen_as_at_rest(image)
    _, after = corrected(before, image)
    top = DISTANCE < 45.0
    wrong, left = (float(np.hypot(one.p - p, one.q - q)[top].mean()) for one in (before, after))
    assert wrong > 0.01
    assert left < 0.3 * wrong


@pytest.mark.parametrize("flank", [0.6, 0.8])
@pytest.mark.parametrize("has_reference", [False, True])
def test_skin_in_shadow_follows_from_the_lamps_that_reach_it(flank: float, has_reference: bool) -> None:
    z = cone(flank)
    q, p = np.gradient(z)
    image, lit = shadowed(z)
    dark = ~lit.all(axis=-1)
    assert 0.01 < dark.mean() < 0.3
    before = field(np.where(dark, 1.5 * p + 0.2 * np.sign(p), p), np.where(dark, 1.5 * q + 0.2 * np.sign(q), q))
    found, after = corrected(before, image, evidence((z > 0.2) | dark) if has_reference else None)
    wrong, left = (np.hypot(one.p - p, one.q - q)[dark].mean() for one in (before, after))
    assert left < 0.36 * wrong
    assert abs(height_px(after) - HEIGHT_PX) < 0.36 * (height_px(before) - HEIGHT_PX)
    sigma_p, _ = found.sigma((SHAPE[1], SHAPE[0]))
    assert np.abs(sigma_p[dark]).mean() > 10.0 * np.abs(sigma_p[~dark]).mean()
    assert after.weight[dark].mean() < 0.8 * after.weight[~dark].mean()


def test_a_pixel_that_a_light_does_not_reach_weighs_as_little_alone_as_in_a_video() -> None:
    z = cone(0.8)
    q, p = np.gradient(z)
    image, lit = shadowed(z)
    _, alone = corrected(field(p, q), image)
    slopes = SimpleNamespace(evaluate=lambda *_: field(p, q))
    known = SimpleNamespace(light=LIGHT, prior_sigma=PRIOR_SIGMA, elevation=BALLS)
    video = read_coarse(image, None, known, "direct", slopes, is_whole=True).gradients  # type: ignore[arg-type]
    np.testing.assert_array_equal(video.weight, alone.weight)
    assert alone.weight.min() == pytest.approx(SHADOW_WEIGHT, abs=1e-6)
    assert np.quantile(alone.weight[~lit.all(axis=-1)], 0.25) == pytest.approx(SHADOW_WEIGHT, abs=1e-6)
    assert np.median(alone.weight[lit.all(axis=-1)]) == 1.0


def test_frames_of_single_lights_show_where_one_does_not_arrive() -> None:
    z = cone(0.3)
    q, p = np.gradient(z)
    band = (COLUMN > 240) & (COLUMN < 276)
    lit = np.repeat(~band[..., None], 3, axis=-1) | np.array([False, True, True])
    image = LAMPS.intensity(z)
    image = replace(image, values=np.asarray(image.values * lit, np.float32))
    before = field(np.where(band, p + 0.3, p), q)
    found = correct_slopes(before, image, LIGHT, PRIOR_SIGMA, BALLS, lit.astype(np.float32))
    _, without = corrected(before, image)
    after = replace(before, p=before.p.copy(), q=before.q.copy(), weight=before.weight.copy())
    found.apply(after)
    assert found.shadow[:, 124:134].min() > 0.5
    assert found.shadow[:, :110].mean() < 0.02
    inner = (COLUMN > 246) & (COLUMN < 270)
    own, other = (float(np.abs(one.p - p)[inner].mean()) for one in (after, without))
    assert own < 0.03
    assert own < other


def test_saturated_pixels_and_holes_stay_as_the_map_shows_them() -> None:
    z = cone(0.3)
    q, p = np.gradient(z)
    image = LAMPS.intensity(z)
    clipped, hole = (COLUMN > 200) & (ROW < 120), (COLUMN < 150) & (ROW < 110)
    broken = NormalizedImage(np.where(hole[..., None], np.float32(np.nan), image.values), ~hole, clipped)
    before = replace(field(0.9 * p, 0.9 * q), valid=~hole, weight=np.where(hole, 0.0, 1.0).astype(np.float32))
    found, after = corrected(before, broken)
    assert np.isfinite(found.p).all()
    assert found.left_alone is not None
    assert (found.left_alone[:58, 102:] == 1.0).all()
    assert not found.left_alone[62:].any()
    np.testing.assert_array_equal(after.p[:110, 210:], before.p[:110, 210:])
    flank = (np.hypot(p, q) > 0.2) & ~hole & ~((COLUMN > 190) & (ROW < 130))
    assert np.abs(after.p - p)[flank].mean() < 0.6 * np.abs(before.p - p)[flank].mean()


def test_noise_leans_level_skin_to_no_side() -> None:
    noise = 0.02 * np.random.default_rng(3).standard_normal((*SHAPE, 3))
    image = NormalizedImage((1.0 + noise).astype(np.float32), EVERYWHERE, ~EVERYWHERE)
    found, _ = corrected(seen_as_at_rest(image), image)
    # Means over a third of the field: 0.01 of slope per pixel averages to a ten-thousandth.
    parts = [np.abs(part[:, at : at + 64].mean()) for part in (found.p, found.q) for at in (0, 64, 128)]
    assert max(parts) < 5e-4


def test_slopes_are_as_uncertain_as_models_of_fewer_balls_differ() -> None:
    z = cone(0.3)
    q, p = np.gradient(z)
    higher, lower = (replace(MODEL, sources=MODEL.sources * [1.0, 1.0, 1.0 + by, 1.0, 1.0]) for by in (0.02, -0.02))
    image = LAMPS.intensity(z)

    def sigma(*folds: object) -> np.ndarray:
        light = replace(LIGHT, folds=folds)
        slope_deviations = correct_slopes(field(p, q), image, light, PRIOR_SIGMA, BALLS).slope_deviations
        assert slope_deviations is not None
        by_p, by_q = slope_deviations()
        return np.sqrt((by_p**2 + by_q**2).sum(axis=0))

    flank = np.hypot(p, q)[::2, ::2] > 0.25
    apart = sigma(higher, lower)
    # Slopes of 0.3 under lamps whose heights differ by 2 % to either side.
    assert 0.001 < apart[flank].mean() < 0.02
    assert not apart[:4].any()
    assert sigma(MODEL, MODEL).max() < 1e-6


def waves() -> np.ndarray:
    """Return the elevation of waves that fill the field, pixels, 4 degrees steep on the mean."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SHAPE[1]), np.fft.fftfreq(SHAPE[0])))
    band = (frequency > 1 / 80) & (frequency < 1 / 16)
    z = np.fft.ifft2(np.fft.fft2(np.random.default_rng(0).standard_normal(SHAPE)) * band).real
    z *= 0.05 / np.hypot(*np.gradient(z)).std()
    return np.asarray(z - np.median(z))


@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (0.98, 1.0, 1.01)])
def test_an_object_under_the_whole_field_has_no_skin_at_rest_and_keeps_its_heights(gain: tuple[float, ...]) -> None:
    z = waves()
    image = noisy(LAMPS.intensity(z + 8.0), np.array(gain))
    before = seen_as_at_rest(image)
    found, after = corrected(before, image, evidence(EVERYWHERE), FEW_CELLS)
    assert not found.has_rest
    wrong, left = (float((integrate(one, 1.0)[0].z_um - z).std()) for one in (before, after))
    assert left < 0.3 * wrong
    assert found.slope_deviations is not None
    assert (np.abs(found.slope_deviations()[0]).max(axis=0) > 0.0).mean() > 0.95


@pytest.mark.parametrize("tilt", [0.0, 0.01])
def test_a_plate_under_the_whole_field_is_no_skin_at_rest(tilt: float) -> None:
    z = 8.0 + tilt * (COLUMN - 0.5 * SHAPE[1])
    image = noisy(LAMPS.intensity(z))
    before = seen_as_at_rest(image)
    found, after = corrected(before, image, evidence(EVERYWHERE), FEW_CELLS)
    assert not found.has_rest
    wrong, left = (float((integrate(one, 1.0)[0].z_um - z).std()) for one in (before, after))
    assert left < 0.3 * wrong


@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (0.98, 1.0, 1.01)])
def test_skin_at_rest_is_no_object_under_the_whole_field(gain: tuple[float, ...]) -> None:
    image = noisy(LAMPS.intensity(ZERO), np.array(gain))
    found, _ = corrected(seen_as_at_rest(image), image, evidence(EVERYWHERE), FEW_CELLS)
    assert found.has_rest
