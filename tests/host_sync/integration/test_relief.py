"""Texture that fills a field, and errors of slopes on untouched skin, which look as flat on the mean."""

import numpy as np
import pytest

from device.surface.fields import GradientField, HeightMap, MaskArray
from device.surface.poisson_dct import integrate_dct
from host_sync.integration.relief import is_relief
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


def test_too_little_skin_tells_nothing() -> None:
    few = np.zeros(SHAPE, np.bool_)
    few[:9, :9] = True
    assert not is_relief(*field(texture(0.03)), few)


def test_texture_over_the_whole_field_has_no_zero_though_it_is_flat_on_the_mean() -> None:
    assert find_datum(*field(texture(0.02))).is_relative
    assert not find_datum(*field(np.zeros(SHAPE))).is_relative
