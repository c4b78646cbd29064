"""Slopes of cells, and what a map makes of intensity whose noise was averaged."""

from dataclasses import replace

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap, rest_nodes
from device.inverse_map.noise_bias import correct_noise_bias
from device.inverse_map.regressor import FeatureRegressor, FeatureScaler
from device.inverse_map.training_domain import TrainingDomain
from host_sync.gradients.inverse_map_kernel import cell_slopes

SHAPE = (120, 160)
NOISE = 0.03


def misreading() -> InverseMap:
    """A map that reads red as p, and 0.02 of it on untouched skin."""
    low, high = np.log([0.05, 5.0]).astype(np.float32)
    space = FeatureScaler(np.zeros(3, np.float32), np.ones(3, np.float32), np.full(3, low), np.full(3, high))
    coefficients = np.zeros((4, 1, 2), np.float32)
    coefficients[0, 0, 0], coefficients[1, 0, 0] = 0.01, 0.1
    domain = TrainingDomain.observed(np.ones((4, 3), np.float32))
    free = InverseMap(SHAPE, domain, FeatureRegressor(space, 1, 0, coefficients), 1.0)
    return replace(free, rest_bump=rest_nodes(free))


def untouched(seed: int) -> NormalizedImage:
    values = 1.0 + NOISE * np.random.default_rng(seed).standard_normal((*SHAPE, 3))
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def test_untouched_skin_reads_flat_by_pixel_and_by_cell() -> None:
    """Noisy pixels look less like untouched skin than their means do: more must be taken off them."""
    noisy = correct_noise_bias(misreading(), [untouched(seed) for seed in range(3)])
    assert noisy.rest_bump is not None
    assert np.median(noisy.rest_bump[..., 0]) > 1.1 * np.median(rest_nodes(replace(noisy, rest_bump=None))[..., 0])
    scan = untouched(9)
    assert abs(noisy.gradients(scan).p.mean()) < 4e-4
    assert abs(cell_slopes(scan, noisy, 8).p.mean()) < 4e-4


def test_means_of_cells_are_read_where_cells_lie() -> None:
    image = NormalizedImage(np.ones((*SHAPE, 3), np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))
    image.values[:, :, 0] += np.linspace(0.0, 0.5, SHAPE[1], dtype=np.float32)
    found = cell_slopes(image, misreading(), 4)
    assert found.p.shape == (30, 40)
    by_pixel = misreading().quiet.gradients(image).p.reshape(30, 4, 40, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(found.p, by_pixel, atol=1e-4)


def test_a_cell_with_an_invalid_pixel_is_invalid() -> None:
    image = untouched(2)
    image.valid[5, 6] = False
    image.values[5, 6] = np.nan
    found = cell_slopes(image, misreading(), 4)
    assert np.flatnonzero(~found.valid).tolist() == [1 * 40 + 1]
    assert found.p[1, 1] == found.q[1, 1] == found.weight[1, 1] == 0.0
    assert np.isfinite(found.p).all()
