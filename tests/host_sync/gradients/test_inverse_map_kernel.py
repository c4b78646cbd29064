"""The compiled evaluation of the inverse map against the portable one."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from device.errors import CalibrationMismatch
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.branches import NearLightBranch, RawLightBranch, RootCurve
from device.inverse_map.model import InverseMap, rest_nodes
from device.inverse_map.near_light import IlluminationMap, NearLightModel
from device.inverse_map.regressor import (
    FeatureRegressor,
    FeatureScaler,
    RandomFourierFeatures,
    colour_exponents,
    position_exponents,
)
from device.inverse_map.training_domain import TrainingDomain
from host_sync.denoising.frame_noise import NullColour
from host_sync.gradients.inverse_map_kernel import evaluate
from host_sync.kernels.cell_rows import in_planes

SHAPE = (150, 300)


def colours(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).lognormal(0.0, 0.3, (4000, 3)).astype(np.float32)


def curve_of(degree: int, position_degree: int, *, linear: bool = False, wavy: bool = False) -> FeatureRegressor:
    random = np.random.default_rng(degree)
    waves = RandomFourierFeatures.sample() if wavy else RandomFourierFeatures.none()
    terms = (len(colour_exponents(degree)) + waves.count, len(position_exponents(position_degree)), 2)
    coefficients = (0.1 * random.standard_normal(terms)).astype(np.float32)
    return FeatureRegressor(
        FeatureScaler.observed(colours(), linear=linear), degree, position_degree, coefficients, waves
    )


def map_of(
    shape: tuple[int, int] = SHAPE,
    position_degree: int = 2,
    *,
    lit: bool = False,
    wavy: bool = False,
    by_slopes: bool = False,
    rooted: bool = False,
) -> InverseMap:
    light = None
    if lit:
        down, across = np.mgrid[:7, :12].astype(np.float32)
        nodes = np.stack([1.2 - 0.05 * down, 0.6 + 0.06 * across, 1.0 + 0.02 * down * across], axis=-1)
        at_rest = np.random.default_rng(4).normal(0.0, 0.2, (7, 12, 2)).astype(np.float32)
        light = RawLightBranch(IlluminationMap(nodes), curve_of(5, 1, linear=True, wavy=wavy), 0.6, at_rest)
    near = NearLightBranch(lights(), curve_of(5, position_degree, linear=True, wavy=wavy)) if by_slopes else None
    curve = curve_of(4, position_degree, wavy=wavy)
    root = RootCurve(curve_of(5, 2, linear=True), 0.3) if rooted else None
    bias = np.random.default_rng(5).normal(0.0, 0.1, (4, 12, 2)).astype(np.float32) if lit or wavy else None
    field = TrainingDomain.observed(colours())
    found = InverseMap(shape, field, curve, 0.8, light, near=near, root=root, noise_bias=bias)
    return replace(found, rest_bump=rest_nodes(found)) if rooted else found


def lights() -> NearLightModel:
    """Three lights around the field, whose directions change over it."""
    directions = np.zeros((6, 2, 3), np.float32)
    angle = np.radians([90.0, 210.0, 330.0])
    directions[0] = np.cos(angle), np.sin(angle)
    directions[1:] = 0.1 * np.random.default_rng(3).standard_normal((5, 2, 3))
    return NearLightModel(directions)


def image_of(shape: tuple[int, int] = SHAPE) -> NormalizedImage:
    """Colours inside the domain, beyond it and far from it; some clipped, some invalid."""
    random = np.random.default_rng(2)
    values = random.lognormal(0.0, 0.5, (*shape, 3)).astype(np.float32)
    values[::17, ::13] = (-0.1, 0.0, 9.0)
    return NormalizedImage(values, random.random(shape) > 0.02, random.random(shape) < 0.02)


@pytest.mark.parametrize("by_slopes", [False, True])
@pytest.mark.parametrize("lit", [False, True])
@pytest.mark.parametrize("wavy", [False, True])
@pytest.mark.parametrize("rooted", [False, True])
@pytest.mark.parametrize("position_degree", [0, 2])
def test_compiled_and_portable_evaluation_agree(
    position_degree: int, rooted: bool, wavy: bool, lit: bool, by_slopes: bool
) -> None:
    inverse = map_of(position_degree=position_degree, lit=lit, wavy=wavy, by_slopes=by_slopes, rooted=rooted)
    image = image_of()
    found, expected = evaluate(inverse, image), inverse.gradients(image)
    np.testing.assert_allclose(found.p, expected.p, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.q, expected.q, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.weight, expected.weight, rtol=1e-3, atol=1e-5)
    np.testing.assert_array_equal(found.valid, expected.valid)
    assert not expected.valid.all()
    assert (expected.weight[expected.valid] < 0.01).any()


def test_a_slope_on_which_curves_disagree_weighs_less() -> None:
    inverse, image = map_of(lit=True), image_of()
    assert inverse.light is not None
    alike = replace(inverse, light=replace(inverse.light, share=0.0))
    quiet = evaluate(replace(alike, light=None), image)
    loud = evaluate(inverse, image)
    assert float(np.median(loud.weight[loud.valid] / quiet.weight[quiet.valid])) < 0.7


@pytest.mark.parametrize("swapped", [False, True])
def test_directions_that_fall_into_one_plane_are_read_alike(swapped: bool) -> None:
    inverse = map_of(by_slopes=True)
    assert inverse.near is not None
    directions = inverse.near.field.directions.copy()
    directions[1] -= (
        1.2 * directions[0]
    )  # by the column's place: the volume is zero within the field, and changes its sign
    if swapped:
        directions = directions[..., ::-1].copy()
    near = NearLightModel(directions)
    assert (near.min_volume < 0.0) == swapped
    inverse, image = replace(inverse, near=replace(inverse.near, field=near)), image_of()
    found, expected = evaluate(inverse, image), inverse.gradients(image)
    np.testing.assert_allclose(found.p, expected.p, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(found.q, expected.q, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 5, 6])
def test_every_degree_is_read_alike(degree: int) -> None:
    inverse = replace(map_of(), curve=curve_of(degree, 2, wavy=degree == 2))
    image = image_of()
    np.testing.assert_allclose(evaluate(inverse, image).p, inverse.gradients(image).p, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("by_plane", [False, True])
@pytest.mark.parametrize("rooted", [False, True])
def test_noise_along_the_null_colour_is_taken_off_alike(rooted: bool, by_plane: bool) -> None:
    random = np.random.default_rng(6)
    null_colour = NullColour(
        random.standard_normal((3, 3, 3)).astype(np.float32),
        (0.1 * random.standard_normal((3, 3, 2))).astype(np.float32),
        0.4,
    )
    inverse, image = map_of(lit=True, rooted=rooted), image_of()
    shrunk = replace(image, values=image.values * np.float32(0.95) + np.float32(0.02))
    stored = [replace(one, values=in_planes(one.values)) if by_plane else one for one in (image, shrunk)]
    row, column = (place.ravel().astype(np.float32) for place in np.mgrid[: SHAPE[0], : SHAPE[1]])
    seen, quiet = (one.values.reshape(-1, 3) for one in (image, shrunk))
    found = evaluate(inverse, stored[0], null_colour, stored[1])
    expected = null_colour.read(inverse, seen, quiet, column, row)
    gentle = np.linalg.norm(expected, axis=1) < 0.99 * inverse.steepest_read
    assert 0.5 < gentle.mean() < 1.0
    assert np.hypot(found.p, found.q).max() <= np.float32(1.0001 * inverse.steepest_read)
    for slope, other in ((found.p, expected[:, 0]), (found.q, expected[:, 1])):
        np.testing.assert_allclose(slope.ravel(), other, rtol=1e-3, atol=1e-3)
    plain = evaluate(inverse, image)
    assert float(np.abs(found.p - plain.p).max()) > 0.01
    np.testing.assert_array_equal(found.weight, plain.weight)
    np.testing.assert_array_equal(evaluate(inverse, image, null_colour).p, plain.p)


def test_a_shrunk_image_of_another_size_is_refused() -> None:
    null_colour = NullColour(np.zeros((3, 3, 3), np.float32), np.zeros((3, 3, 2), np.float32), 1.0)
    with pytest.raises(CalibrationMismatch, match="300x150"):
        evaluate(map_of(), image_of(), null_colour, image_of((20, 30)))


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
