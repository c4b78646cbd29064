"""The paper's integration: a pixel's slope is the step to its next neighbour, and all pixels have equal weight."""

import numpy as np
import pytest

from device.surface import GradientField
from host_sync.johnson2009.model import integrate_forward_difference

PITCH_UM = 5.0


def field(weight: np.ndarray) -> GradientField:
    row, column = np.mgrid[:40, :60].astype(np.float32)
    return GradientField(0.01 * column, -0.02 * row, np.ones((40, 60), bool), weight.astype(np.float32))


def test_heights_are_running_sums_of_the_slopes() -> None:
    height, report = integrate_forward_difference(field(np.ones((40, 60))), PITCH_UM)
    assert report.converged
    row, column = np.mgrid[:40, :60]
    sums = 0.01 * column * (column - 1) / 2 - 0.02 * row * (row - 1) / 2  # column² and row² for the true surface
    np.testing.assert_allclose(height.z_um / PITCH_UM, sums - sums.mean(), atol=2e-2)


def test_no_pixel_weighs_more_than_another() -> None:
    rng = np.random.default_rng(0)
    even = field(np.ones((40, 60)))
    noisy = GradientField(
        even.p + rng.normal(0.0, 0.1, even.p.shape).astype(np.float32), even.q, even.valid, even.weight
    )
    uneven = GradientField(noisy.p, noisy.q, noisy.valid, rng.uniform(0.1, 1.0, even.p.shape).astype(np.float32))
    one, other = (integrate_forward_difference(gradients, PITCH_UM)[0].z_um for gradients in (noisy, uneven))
    assert np.abs(one - other).max() == pytest.approx(0.0, abs=1e-5)
