"""Confidence that does not follow the noise of single pixels."""

from __future__ import annotations

import numpy as np
import pytest

from device.surface import GradientField
from host_sync.gradients.confidence import CELL_PX, even_confidence
from host_sync.kernels.jit import get_num_threads, set_num_threads

SHAPE = (403, 401)
"""Pixels, no whole number of cells; enough for two threads."""


def field(p: np.ndarray, weight: np.ndarray) -> GradientField:
    p, weight = p.astype(np.float32), weight.astype(np.float32)
    return GradientField(p, p.copy(), np.ones(p.shape, np.bool_), weight.copy())


def weighted_mean(gradients: GradientField) -> float:
    return float((gradients.p * gradients.weight).sum() / gradients.weight.sum())


def test_slopes_that_noise_makes_steep_count_as_much_as_those_it_makes_gentle() -> None:
    noise = np.random.default_rng(5).normal(0.0, 0.07, SHAPE)
    gradients = field(noise, np.where(noise > 0.0, 0.3, 1.0))
    assert weighted_mean(gradients) < -0.025
    even_confidence(gradients, np.zeros(SHAPE, np.bool_))
    assert abs(weighted_mean(gradients)) < 0.003
    assert gradients.weight.mean() == pytest.approx(0.65, abs=0.01)


def test_confidence_that_changes_slowly_stays() -> None:
    down, across = np.meshgrid(np.linspace(0.2, 0.6, SHAPE[0]), np.linspace(0.0, 0.3, SHAPE[1]), indexing="ij")
    gradients = field(np.zeros(SHAPE), down + across)
    even_confidence(gradients, np.zeros(SHAPE, np.bool_))
    np.testing.assert_allclose(gradients.weight, down + across, atol=0.003)


def test_pixels_without_a_slope_saturated_and_strange_ones_keep_theirs_and_count_for_no_other() -> None:
    gradients = field(np.zeros(SHAPE), np.full(SHAPE, 0.8))
    clipped = np.zeros(SHAPE, np.bool_)
    lost, bright = np.s_[40 : 40 + 3 * CELL_PX, 60:90], np.s_[200:203, 300:301]
    gradients.valid[lost], gradients.weight[lost] = False, 0.0
    clipped[bright], gradients.weight[bright] = True, 0.1
    gradients.weight[120, 77] = 0.001  # dust
    even_confidence(gradients, clipped)
    assert (gradients.weight[lost] == 0.0).all()
    assert gradients.weight[120, 77] == np.float32(0.001)
    gradients.weight[120, 77] = 0.8
    np.testing.assert_array_equal(gradients.weight[bright], np.float32(0.1))
    np.testing.assert_allclose(gradients.weight[gradients.valid & ~clipped], 0.8, rtol=1e-5)


def test_it_does_not_depend_on_the_number_of_threads() -> None:
    weight = np.random.default_rng(6).random(SHAPE)
    found = []
    before = get_num_threads()
    for threads in (1, 2):
        set_num_threads(min(threads, before))
        gradients = field(np.zeros(SHAPE), weight)
        even_confidence(gradients, np.zeros(SHAPE, np.bool_))
        found.append(gradients.weight)
    set_num_threads(before)
    np.testing.assert_array_equal(*found)
