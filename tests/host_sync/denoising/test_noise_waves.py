"""Long waves are taken out of a frame that shows nothing, and out of no other."""

import numpy as np
import pytest

from device.surface.fields import Float32Array, GradientField, HeightMap, surface_slopes
from host_sync.denoising.noise_waves import CLEAR_POWER, NoiseWaves, noise_waves
from host_sync.integration.integrate import integrate

SHAPE = (360, 480)
NOISE = 0.02
PITCH_UM = 25.0
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)


def field(z_px: Float32Array | np.ndarray, noise: float = NOISE, seed: int = 0) -> GradientField:
    """Slopes of a surface with noise from pixel to pixel."""
    rng = np.random.default_rng(seed)
    p, q = surface_slopes(HeightMap(np.asarray(z_px, np.float32), 1.0))
    noisy = [np.asarray(part + noise * rng.standard_normal(SHAPE), np.float32) for part in (p, q)]
    return GradientField(noisy[0], noisy[1], np.ones(SHAPE, np.bool_), np.ones(SHAPE, np.float32))


def read(gradients: GradientField) -> tuple[HeightMap, HeightMap, float | None]:
    """The height map as integrated, the same without noise's waves, and the power of what was found."""
    height, _ = integrate(gradients, PITCH_UM)
    waves = noise_waves(height, gradients)
    return (height, height, None) if waves is None else (height, waves.off(height), waves.power)


def long_um(z_um: Float32Array) -> float:
    """Root mean square of what is left of a height map over patches of 24 pixels."""
    rows, columns = (size // 24 * 24 for size in z_um.shape)
    patches = z_um[:rows, :columns].reshape(rows // 24, 24, columns // 24, 24).mean(axis=(1, 3))
    return float(np.nanstd(patches))


def cap(radius_px: float, height_px: float) -> np.ndarray:
    """A ball's cap in the field."""
    square = (ROW - 150.0) ** 2 + (COLUMN - 300.0) ** 2
    return np.maximum(0.0, height_px * (1.0 - square / radius_px**2))


@pytest.mark.parametrize("seed", range(4))
def test_what_noise_makes_of_untouched_skin_is_flat(seed: int) -> None:
    height, found, power = read(field(np.zeros(SHAPE), seed=seed))
    assert power is not None
    assert 1.0 < power < CLEAR_POWER[0]
    assert long_um(found.z_um) < 0.2 * long_um(height.z_um)


def test_a_bowl_that_is_misread_of_untouched_skin_goes_with_it() -> None:
    across, down = COLUMN / SHAPE[1] - 0.5, ROW / SHAPE[0] - 0.5
    bowl_px = 0.02 * (np.cos(2.0 * np.pi * across) + np.cos(2.0 * np.pi * down))
    height, found, power = read(field(bowl_px))
    assert power is not None
    assert long_um(height.z_um) > 0.5
    assert long_um(found.z_um) < 0.1


@pytest.mark.parametrize(
    "z_px",
    [
        cap(100.0, 20.0),
        cap(12.0, 0.6),
        np.where(np.abs(COLUMN - 200.0) < 2.5, -0.25, 0.0) * (ROW > 80),
        0.3 * np.sin(2.0 * np.pi * COLUMN / 40.0),
        (COLUMN - 240.0) ** 2 * 1e-4,
    ],
    ids=["ball", "grain", "scratch", "wave", "cylinder"],
)
def test_a_frame_that_shows_something_keeps_all_of_it(z_px: np.ndarray) -> None:
    height, found, power = read(field(z_px))
    assert power is None
    assert found is height


def test_a_plate_that_is_tilted_by_a_few_times_the_noise_stays_tilted() -> None:
    """No shorter wave tells of it."""
    tilt_px = (COLUMN / SHAPE[1] - 0.5) * 2.0
    _, found, _ = read(field(tilt_px))
    kept = np.polyfit(COLUMN[0], np.asarray(found.z_um, np.float64).mean(axis=0) / PITCH_UM, 1)[0] * SHAPE[1]
    assert kept == pytest.approx(2.0, rel=0.04)


def test_pixels_without_a_height_stay_without_one_and_the_rest_is_flat() -> None:
    gradients = field(np.zeros(SHAPE))
    hole = (slice(100, 160), slice(200, 270))
    for part in (gradients.p, gradients.q):
        part[hole] = np.nan
    gradients.valid[hole] = False
    gradients.weight[hole] = 0.0
    height, found, power = read(gradients)
    assert power is not None
    assert np.array_equal(np.isnan(found.z_um), ~gradients.valid)
    assert long_um(found.z_um) < 0.3 * long_um(height.z_um)


@pytest.mark.parametrize("shape", [(40, 40), (357, 481), (200, 900)])
def test_fields_of_any_size(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    p, q = (np.asarray(NOISE * rng.standard_normal(shape), np.float32) for _ in range(2))
    gradients = GradientField(p, q, np.ones(shape, np.bool_), np.ones(shape, np.float32))
    height, found, power = read(gradients)
    assert found.z_um.shape == shape
    assert (power is None) == (shape == (40, 40))
    assert power is None or long_um(found.z_um) < 0.4 * long_um(height.z_um)


def test_a_field_without_any_noise_is_left_alone() -> None:
    _, found, _ = read(field(np.zeros(SHAPE), noise=0.0))
    assert long_um(found.z_um) == 0.0


@pytest.mark.parametrize(("wide_px", "high_px"), [(4.0, 0.5), (7.0, 0.4), (12.0, 0.3), (25.0, 0.3)])
def test_a_faint_dome_that_is_small_beside_the_field_keeps_all_of_its_height(wide_px: float, high_px: float) -> None:
    square = (ROW - 150.0) ** 2 + (COLUMN - 300.0) ** 2
    height, found, power = read(field(high_px * np.exp(-square / (2.0 * wide_px**2))))
    assert power is None
    assert found is height


def test_pure_noise_is_hardly_ever_taken_for_something() -> None:
    powers = [read(field(np.zeros(SHAPE), seed=seed))[2] for seed in range(100, 120)]
    assert sum(power is None or power > CLEAR_POWER[0] for power in powers) <= 2


def test_noise_that_is_louder_in_dim_corners_is_noise() -> None:
    rng = np.random.default_rng(7)
    loud = 1.0 + 3.0 * ((COLUMN / SHAPE[1] - 0.5) ** 2 + (ROW / SHAPE[0] - 0.5) ** 2)
    p, q = (np.asarray(NOISE * loud * rng.standard_normal(SHAPE), np.float32) for _ in range(2))
    gradients = GradientField(p, q, np.ones(SHAPE, np.bool_), np.ones(SHAPE, np.float32))
    height, found, _ = read(gradients)
    assert long_um(found.z_um) < 0.5 * long_um(height.z_um)


def test_a_third_of_what_was_taken_is_doubted_and_what_is_left_of_noise_is_all_the_rest() -> None:
    taken = np.full((8, 12), 3.0, np.float32)
    sigma, samples = np.full((8, 12), 2.0, np.float32), np.ones((16, 4, 6), np.float32)
    sigma[0, 0] = np.nan
    found, drawn = NoiseWaves(taken, 3.0, 0.25).doubted(sigma, samples)
    assert np.isnan(found[0, 0])
    np.testing.assert_allclose(found[1:], np.hypot(0.5, 1.0), rtol=1e-6)
    assert drawn.shape == samples.shape
    apart = drawn[:, 0, 0] - 0.25
    assert np.sqrt((apart**2).mean()) == pytest.approx(1.0, rel=0.5)
    np.testing.assert_allclose(drawn, drawn[:, :1, :1] * np.ones_like(drawn), rtol=1e-6)
