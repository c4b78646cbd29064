"""The last step of the finest level: a correction is interpolated and added, and nothing is smoothed after it.

What a pass over the pixels costs is mostly their edges, which smoothing needs and this does not. What interpolation
leaves uneven is small beside the correction, which is small beside noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from device.surface import Float32Array
from host_sync.reconstruction.row_bands import in_bands
from host_sync.reconstruction.transfer import copy_row, prolong_row, prolong_weighted_row


def add_correction(z: Float32Array, coarse: Float32Array, weight: Float32Array | None) -> None:
    """Add heights of the next level to those of the pixels, in place.

    z : float32 array of shape (H, W)
    coarse : float32 array of shape (ceil(H / 2), ceil(W / 2))
    weight : float32 array of shape (H, W), nought at holes, over which nothing is interpolated; None without holes
    """
    in_bands(_add_rows, z.shape, z, coarse, weight)


@njit(cache=True, nogil=True)
def _add_rows(z: Any, coarse: Any, weight: Any, first: int, last: int) -> None:
    rows, columns = z.shape
    padded = np.zeros(columns + 2, np.float32)
    added = padded[1 : columns + 1]
    across, over = np.zeros(columns + 1, np.float32), np.zeros(columns, np.float32)
    for r in range(first, last):
        copy_row(z[r], 0, added, 0, columns)
        beyond = r + 2 * (r % 2) - 1
        near, far = coarse[r // 2], coarse[min(max(r // 2 + 2 * (r % 2) - 1, 0), coarse.shape[0] - 1)]
        if weight is None:
            prolong_row(near, far, padded)
        else:
            _lesser(weight[r, 1:], weight[r, : columns - 1], across[1:columns])
            _lesser(weight[r], weight[min(max(beyond, 0), rows - 1)], over)
            prolong_weighted_row(near, far, across, over, padded)
        copy_row(added, 0, z[r], 0, columns)


@njit(cache=True)
def _lesser(one: Any, other: Any, out: Any) -> None:
    """Write the lesser of the weights that an edge joins, nought where one is a hole."""
    for c in range(out.size):
        out[c] = min(one[c], other[c])
