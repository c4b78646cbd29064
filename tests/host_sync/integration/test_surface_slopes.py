"""The compiled slopes of a height map are the portable ones."""

import numpy as np
import pytest

from device.surface import HeightMap
from device.surface import surface_slopes as portable
from host_sync.integration.integrate import surface_slopes


@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (2, 7), (4, 5), (5, 4), (6, 6), (40, 57), (520, 700)])
@pytest.mark.parametrize("holes", [0.0, 0.04])
def test_as_the_portable_ones_at_holes_and_borders(shape: tuple[int, int], holes: float) -> None:
    rng = np.random.default_rng(shape[0])
    z_um = rng.standard_normal(shape).astype(np.float32) * np.float32(30.0)
    z_um[rng.random(shape) < holes] = np.nan
    height = HeightMap(z_um, 12.0)
    for found, expected in zip(surface_slopes(height), portable(height), strict=True):
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=5e-6)
