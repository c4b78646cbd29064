"""Sums of a surface over cells, against sums taken cell by cell."""

from __future__ import annotations

import numpy as np
import pytest

from device.surface import Float32Array, GradientField, HeightMap, MaskArray
from host_sync.integration.datum import SurfaceCells

PITCH_UM = 12.0
ZERO_UM = 40.0


def surface(shape: tuple[int, int], seed: int) -> tuple[HeightMap, GradientField, MaskArray]:
    """Heights and slopes with holes, each of its own, and skin."""
    random = np.random.default_rng(seed)
    z_um, p, q = (random.standard_normal(shape).astype(np.float32) for _ in range(3))
    z_um = np.float32(ZERO_UM) + np.float32(30.0) * z_um
    valid, skin = random.random(shape) < 0.8, random.random(shape) < 0.5
    z_um[random.random(shape) < 0.1] = np.nan
    p[~valid], q[~valid] = np.nan, np.nan
    return HeightMap(z_um, PITCH_UM), GradientField(p, q, valid, np.ones(shape, np.float32)), skin


def cell_by_cell(values: np.ndarray, cell: int) -> np.ndarray:
    return np.array(
        [
            [values[top : top + cell, left : left + cell].sum() for left in range(0, values.shape[1], cell)]
            for top in range(0, values.shape[0], cell)
        ]
    )


@pytest.mark.parametrize(
    ("shape", "cell"), [((12, 20), 4), ((13, 22), 5), ((7, 3), 1), ((3, 40), 8), ((4, 5), 9), ((401, 403), 6)]
)
def test_cells_hold_sums_of_pixels_with_slope_and_height_at_the_border_too(shape: tuple[int, int], cell: int) -> None:
    height, gradients, skin = surface(shape, cell)
    found = SurfaceCells.of(height, gradients, ZERO_UM, skin, cell)
    known = gradients.valid & np.isfinite(height.z_um)
    z_px = (height.z_um.astype(np.float64) - ZERO_UM) / PITCH_UM
    wanted = {"z_px": z_px, "p": gradients.p, "q": gradients.q}
    for name, values in wanted.items():
        sums = cell_by_cell(np.where(known, values, 0.0).astype(np.float64), cell)
        np.testing.assert_allclose(getattr(found, name), sums, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(found.count, cell_by_cell(known, cell))
    np.testing.assert_array_equal(found.skin, cell_by_cell(known & skin, cell))


def test_parts_of_larger_arrays_are_read_where_they_lie() -> None:
    height, gradients, skin = surface((30, 44), 3)

    def part(values: Float32Array) -> Float32Array:
        return values[3:25:2, 5:38]

    own = [part(values) for values in (gradients.p, gradients.q, gradients.valid, gradients.weight)]
    apart = SurfaceCells.of(HeightMap(part(height.z_um), PITCH_UM), GradientField(*own), ZERO_UM, part(skin), 4)
    copied = GradientField(*(values.copy() for values in own))
    heights = HeightMap(part(height.z_um).copy(), PITCH_UM)
    wanted = SurfaceCells.of(heights, copied, ZERO_UM, part(skin).copy(), 4)
    for name in ("z_px", "p", "q", "count", "skin"):
        np.testing.assert_array_equal(getattr(apart, name), getattr(wanted, name))
