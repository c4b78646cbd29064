"""Change of pixels' slopes by cells, and their weights in shadow."""

from __future__ import annotations

import numpy as np

from device.surface import GradientField
from host_sync.light.cells import SHADOW_WEIGHT
from host_sync.light.reading import CellCorrection

CELL = 4
SIZE = (20, 30)
SHAPE = (SIZE[0] * CELL, SIZE[1] * CELL)


def correction() -> CellCorrection:
    shadow = np.zeros(SIZE, np.float32)
    shadow[:, :10] = 1.0
    nothing = np.zeros(SIZE, np.float32)
    return CellCorrection(nothing, nothing, nothing, nothing, shadow, CELL)


def field() -> GradientField:
    p, q = (np.zeros(SHAPE, np.float32) for _ in range(2))
    weight = np.linspace(0.5, 1.0, SHAPE[1], dtype=np.float32)[None, :].repeat(SHAPE[0], axis=0)
    return GradientField(p, q, np.ones(SHAPE, np.bool_), np.ascontiguousarray(weight))


def test_pixels_gain_what_cells_gain_and_run_straight_between_them() -> None:
    """Of planes, which are straight everywhere, every pixel between the middles of cells gains the plane's value."""
    row, column = (CELL * np.arange(count) + 0.5 * (CELL - 1) for count in SIZE)
    p, q = (np.float32(0.001) * (by_row * row[:, None] + by_column * column) for by_row, by_column in ((1, 2), (-3, 1)))
    nothing = np.zeros(SIZE, np.float32)
    found = field()
    CellCorrection(p.astype(np.float32), q.astype(np.float32), nothing, nothing, nothing, CELL).apply(found)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    inner = slice(CELL, -CELL), slice(CELL, -CELL)
    np.testing.assert_allclose(found.p[inner], 0.001 * (rows + 2 * columns)[inner], atol=1e-6)
    np.testing.assert_allclose(found.q[inner], 0.001 * (columns - 3 * rows)[inner], atol=1e-6)
    np.testing.assert_array_equal(found.weight, field().weight)


def test_weights_are_smaller_in_shadow() -> None:
    taken, before = field(), field()
    correction().apply(taken)
    assert taken.weight[:, :20].max() < 0.25
    np.testing.assert_allclose(taken.weight[:, :36], SHADOW_WEIGHT * before.weight[:, :36], rtol=1e-5)
    np.testing.assert_array_equal(taken.weight[:, 44:], before.weight[:, 44:])
