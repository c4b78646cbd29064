"""Texture that fills a field, and errors of slopes on untouched skin, which look as flat on the mean."""

import numpy as np
import pytest

from device.surface import GradientField, HeightMap, MaskArray, integrate_dct
from host_sync.integration.datum import is_relief
from host_sync.integration.zero_level import find_datum

SHAPE = (240, 320)
EVERYWHERE = np.ones(SHAPE, np.bool_)
NOISE = 0.01


def texture(steepness: float) -> np.ndarray:
    """Heights of random waves of 15 to 60 px, px, whose slopes have that root mean square."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SHAPE[1]), np.fft.fftfreq(SHAPE[0])))
    band = (frequency > 1 / 60) & (frequency < 1 / 15)
    z = np.fft.ifft2(np.fft.fft2(np.random.default_rng(0).standard_normal(SHAPE)) * band).real
    return z * steepness / np.hypot(*np.gradient(z)).std()


def field(z: np.ndarray) -> tuple[HeightMap, GradientField]:
    """The height map of noisy slopes, and the slopes."""
    rng = np.random.default_rng(1)
    q, p = (np.asarray(part + NOISE * rng.standard_normal(SHAPE), np.float32) for part in np.gradient(z))
    return HeightMap(integrate_dct(p, q, 1.0), 1.0), GradientField(p, q, EVERYWHERE, np.ones(SHAPE, np.float32))


def with_hole(side: int) -> MaskArray:
    """All skin but a square in the middle."""
    mask = EVERYWHERE.copy()
    mask[120 - side : 120 + side, 160 - side : 160 + side] = False
    return mask


@pytest.mark.parametrize("steepness", [0.01, 0.03])
def test_texture_is_a_surface(steepness: float) -> None:
    assert is_relief(*field(texture(steepness)), with_hole(40))


def test_noise_is_none_and_neither_is_a_smooth_bowl_of_wrong_slopes() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    bowl = 2.0 * np.hypot((row - 120) / 120, (column - 160) / 160) ** 2
    for z in (np.zeros(SHAPE), bowl):
        assert not is_relief(*field(z), with_hole(40))


def test_skin_near_a_steep_object_is_not_judged_by_it() -> None:
    hill = 20.0 * np.exp(-(np.hypot(*(np.mgrid[: SHAPE[0], : SHAPE[1]] - np.array([[[120]], [[160]]]))) ** 2) / 800.0)
    assert not is_relief(*field(hill), with_hole(70))


def test_waves_of_an_objects_foot_are_no_texture() -> None:
    quiet = texture(0.003)
    rng = np.random.default_rng(1)
    q, p = (np.asarray(part + 0.0005 * rng.standard_normal(SHAPE), np.float32) for part in np.gradient(quiet))
    gradients = GradientField(p, q, EVERYWHERE, np.ones(SHAPE, np.float32))
    assert not is_relief(HeightMap(integrate_dct(p, q, 1.0), 1.0), gradients, EVERYWHERE)


def test_texture_on_less_than_nine_tenths_of_the_skin_is_an_object_beside_untouched_skin() -> None:
    row, _ = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert not is_relief(*field(texture(0.03) / (1.0 + np.exp((row - 150) / 4.0))), EVERYWHERE)


@pytest.mark.parametrize("off_px", [0.0, 30.0])
def test_holes_and_the_zero_of_the_map_do_not_matter(off_px: float) -> None:
    holes = np.zeros(SHAPE, np.bool_)
    for row, column in np.random.default_rng(2).integers(0, (230, 310), (12, 2)):
        holes[row : row + 8, column : column + 8] = True
    for z, answer in ((texture(0.03), True), (np.zeros(SHAPE), False)):
        height, gradients = field(z)
        z_px = np.where(holes, np.float32(np.nan), height.z_um + np.float32(off_px))
        p, q = (np.where(holes, np.float32(0.0), part) for part in (gradients.p, gradients.q))
        known = GradientField(p, q, ~holes, (~holes).astype(np.float32))
        assert is_relief(HeightMap(z_px, 1.0), known, ~holes) == answer


@pytest.mark.parametrize("shape", [(4, 960), (960, 4), (8, 8), (3, 3)])
def test_a_field_of_a_few_rows_shows_nothing(shape: tuple[int, int]) -> None:
    flat, everywhere = np.zeros(shape, np.float32), np.ones(shape, np.bool_)
    gradients = GradientField(flat, flat, everywhere, np.ones(shape, np.float32))
    assert not is_relief(HeightMap(flat, 1.0), gradients, everywhere)


def test_too_little_skin_shows_nothing() -> None:
    few = np.zeros(SHAPE, np.bool_)
    few[:9, :9] = True
    assert not is_relief(*field(texture(0.03)), few)


def test_texture_over_the_whole_field_has_no_zero_though_it_is_flat_on_the_mean() -> None:
    height, gradients = field(texture(0.02))
    assert find_datum(height, gradients).is_relative
    q, p = (np.asarray(part, np.float32) for part in np.gradient(height.z_um))
    own = GradientField(p, q, EVERYWHERE, gradients.weight)
    assert not find_datum(height, own, are_its_own=True).is_relative
    assert not find_datum(*field(np.zeros(SHAPE))).is_relative
