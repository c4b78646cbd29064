"""Cells brought to pixels inside a kernel: as OpenCV enlarges them."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from device.surface import Float32Array
from host_sync.kernels.cell_rows import bordered, cells_above, expand_cells, means_of_cells

RUN = 11
"""Columns that are expanded at a time."""


def enlarged(planes: Float32Array, cell: int, shape: tuple[int, int]) -> Float32Array:
    """Planes (T, h, w) at every pixel: float32 array of shape (T, H, W)."""
    around = bordered(planes)
    out = np.empty((len(planes), *shape), np.float32)
    for row in range(shape[0]):
        top, share = cells_above(row, cell, around.shape[1])
        for first, end in pairwise([*range(0, shape[1], RUN), shape[1]]):
            upper, step = (np.full((len(planes), end - first), np.nan, np.float32) for _ in range(2))
            expand_cells(around, top, cell, first, upper, step)
            out[:, row, first:end] = upper + share * step
    return out


@pytest.mark.parametrize(("cell", "cut"), [(1, 0), (2, 0), (3, 2), (8, 5), (8, 7)])
def test_every_pixel_is_as_in_an_enlarged_picture(cell: int, cut: int) -> None:
    planes = np.random.default_rng(cell).standard_normal((2, 5, 7)).astype(np.float32)
    rows, columns = 5 * cell, 7 * cell
    found = enlarged(planes, cell, (rows - cut, columns - cut))
    for plane, here in zip(planes, found, strict=True):
        expected = cv2.resize(plane, (columns, rows), interpolation=cv2.INTER_LINEAR)
        np.testing.assert_allclose(here, expected[: rows - cut, : columns - cut], atol=2e-6)


@pytest.mark.parametrize(
    ("shape", "cell"),
    [((12, 20), 4), ((13, 20), 4), ((12, 21), 4), ((14, 23), 5), ((3, 40), 8), ((2, 3), 7), ((5, 6), 1)],
)
@pytest.mark.parametrize("by_plane", [False, True])
def test_means_repeat_the_last_pixels_in_cells_that_the_border_cuts(
    shape: tuple[int, int], cell: int, by_plane: bool
) -> None:
    values = np.random.default_rng(cell).standard_normal((*shape, 2)).astype(np.float32)
    if by_plane:
        values = np.moveaxis(np.ascontiguousarray(np.moveaxis(values, -1, 0)), 0, -1)
    size = -(-shape[0] // cell), -(-shape[1] // cell)
    missing = [(0, count * cell - have) for count, have in zip(size, shape, strict=True)]
    whole = np.pad(values.astype(np.float64), (*missing, (0, 0)), mode="edge")
    wanted = whole.reshape(size[0], cell, size[1], cell, 2).mean(axis=(1, 3))
    found = means_of_cells(values, size, cell)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, wanted, atol=1e-6)
