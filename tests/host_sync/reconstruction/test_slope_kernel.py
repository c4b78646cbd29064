"""The compiled evaluation of the inverse map against the portable one."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from device.colour_domain import ColourDomain
from device.colour_space import ColourSpace
from device.colour_waves import ColourWaves
from device.curve_readings import LightCurve, NearCurve
from device.errors import CalibrationMismatch
from device.inverse_map import InverseMap
from device.light_field import LightField
from device.near_field import NearField
from device.photometry import IntensityImage
from device.polynomials import colour_exponents, position_exponents
from device.slope_curve import SlopeCurve
from host_sync.reconstruction.slope_kernel import evaluate

SHAPE = (150, 300)


def colours(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).lognormal(0.0, 0.3, (4000, 3)).astype(np.float32)


def curve_of(degree: int, position_degree: int, *, linear: bool = False, wavy: bool = False) -> SlopeCurve:
    random = np.random.default_rng(degree)
    waves = ColourWaves.drawn() if wavy else ColourWaves.none()
    terms = (len(colour_exponents(degree)) + waves.count, len(position_exponents(position_degree)), 2)
    coefficients = (0.1 * random.standard_normal(terms)).astype(np.float32)
    return SlopeCurve(ColourSpace.observed(colours(), linear=linear), degree, position_degree, coefficients, waves)


def map_of(
    shape: tuple[int, int] = SHAPE,
    position_degree: int = 2,
    *,
    lit: bool = False,
    wavy: bool = False,
    by_slopes: bool = False,
) -> InverseMap:
    light = None
    if lit:
        down, across = np.mgrid[:7, :12].astype(np.float32)
        nodes = np.stack([1.2 - 0.05 * down, 0.6 + 0.06 * across, 1.0 + 0.02 * down * across], axis=-1)
        light = LightCurve(LightField(nodes), curve_of(5, 1, linear=True, wavy=wavy), 0.6)
    near = NearCurve(lights(), curve_of(5, position_degree, linear=True, wavy=wavy)) if by_slopes else None
    curve = curve_of(4, position_degree, wavy=wavy)
    return InverseMap(shape, ColourDomain.observed(colours()), curve, 0.8, light, near=near)


def lights() -> NearField:
    """Three lights around the field, whose directions change over it."""
    directions = np.zeros((6, 2, 3), np.float32)
    angle = np.radians([90.0, 210.0, 330.0])
    directions[0] = np.cos(angle), np.sin(angle)
    directions[1:] = 0.1 * np.random.default_rng(3).standard_normal((5, 2, 3))
    return NearField(directions)


def image_of(shape: tuple[int, int] = SHAPE) -> IntensityImage:
    """Colours inside the domain, beyond it and far from it; some clipped, some invalid."""
    random = np.random.default_rng(2)
    values = random.lognormal(0.0, 0.5, (*shape, 3)).astype(np.float32)
    values[::17, ::13] = (-0.1, 0.0, 9.0)
    return IntensityImage(values, random.random(shape) > 0.02, random.random(shape) < 0.02)


@pytest.mark.parametrize("by_slopes", [False, True])
@pytest.mark.parametrize("lit", [False, True])
@pytest.mark.parametrize("wavy", [False, True])
@pytest.mark.parametrize("position_degree", [0, 1, 2])
def test_compiled_and_portable_evaluation_agree(position_degree: int, wavy: bool, lit: bool, by_slopes: bool) -> None:
    inverse, image = map_of(position_degree=position_degree, lit=lit, wavy=wavy, by_slopes=by_slopes), image_of()
    found, expected = evaluate(inverse, image), inverse.gradients(image)
    np.testing.assert_allclose(found.p, expected.p, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.q, expected.q, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.weight, expected.weight, rtol=1e-3, atol=1e-5)
    np.testing.assert_array_equal(found.valid, expected.valid)
    assert not expected.valid.all()
    assert (expected.weight[expected.valid] < 0.01).any()


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 5, 6])
def test_every_degree_is_read_alike(degree: int) -> None:
    inverse = replace(map_of(), curve=curve_of(degree, 2, wavy=degree == 2))
    image = image_of()
    np.testing.assert_allclose(evaluate(inverse, image).p, inverse.gradients(image).p, rtol=1e-4, atol=1e-4)


def test_one_and_two_threads_give_the_same_bits() -> None:
    inverse, image = map_of((1088, 1456)), image_of((1088, 1456))
    results = []
    before = numba.get_num_threads()
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            results.append(evaluate(inverse, image))
    finally:
        numba.set_num_threads(before)
    for name in ("p", "q", "weight", "valid"):
        np.testing.assert_array_equal(getattr(results[0], name), getattr(results[1], name))


def test_another_size_is_refused() -> None:
    with pytest.raises(CalibrationMismatch, match="300x150"):
        evaluate(map_of(), image_of((20, 30)))
