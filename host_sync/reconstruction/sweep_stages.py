"""The stages of a pass over a level, row by row: where it starts, a step of smoothing, what is left.

Rows of heights stand in rings of padded rows, row r at r mod the ring's length; those of edges and of the right-hand
side stand in rings (`level_rows`) or where the level stores them, which for this is a ring as long as the level.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from host_sync.reconstruction.smoother import (
    relax_row,
    residual_row,
    scale_row,
    unit_relax_row,
    unit_residual_row,
    unit_scale_row,
)
from host_sync.reconstruction.transfer import add_cells, copy_row, prolong_row, prolong_weighted_row


@njit(cache=True)
def start_rows(
    row: int, rows: int, z_in: Any, begun: bool, coarse: Any, nested: bool, across: Any, down: Any, upper: Any,
    lower: Any,
) -> None:  # fmt: skip
    """Write two rows before smoothing, padding included; `begun` where they are written already."""
    columns = upper.size - 2
    for r in range(row, min(row + 2, rows)):
        out = upper if r == row else lower
        if z_in.size > 0:
            copy_row(z_in[r], 0, out, 1, columns)
        elif not begun:
            for c in range(out.size):
                out[c] = np.float32(0.0)
        if coarse.size > 0 and not begun:
            near = r // 2
            far = min(max(near + 2 * (r % 2) - 1, 0), coarse.shape[0] - 1)
            if nested:
                add_cells(coarse[near], out)
            elif across is None:
                prolong_row(coarse[near], coarse[far], out)
            else:
                a, d = r % across.shape[0], (r + r % 2) % down.shape[0]
                prolong_weighted_row(coarse[near], coarse[far], across[a], down[d], out)
        out[0], out[columns + 1] = out[1], out[columns]


@njit(cache=True)
def write_first(rhs: Any, across: Any, inverse: Any, step: Any, r: int, out: Any) -> None:
    """Write row `r` of the first stage where all heights are nought, without padding."""
    b = rhs[r % rhs.shape[0]]
    if across is None:
        unit_scale_row(b, step, out)
    else:
        scale_row(b, inverse[r % inverse.shape[0]], step, out)


@njit(cache=True)
def write_relaxed(
    z: Any, rhs: Any, across: Any, down: Any, inverse: Any, step: Any, r: int, rows: int, out: Any
) -> None:
    """Write row `r` of the next stage from the rows of ring `z`, without padding."""
    n = z.shape[0]
    up, low = max(r - 1, 0), min(r + 1, rows - 1)
    b = rhs[r % rhs.shape[0]]
    if across is None:
        unit_relax_row(z[up % n], z[r % n], z[low % n], b, step, out)
    else:
        a, u, d = across[r % across.shape[0]], down[r % down.shape[0]], down[(r + 1) % down.shape[0]]
        relax_row(z[up % n], z[r % n], z[low % n], b, a, u, d, inverse[r % n], step, out)


@njit(cache=True)
def write_residual(z: Any, rhs: Any, across: Any, down: Any, r: int, rows: int, out: Any) -> None:
    """Write row `r` of the residual from the rows of ring `z`."""
    n = z.shape[0]
    up, low = max(r - 1, 0), min(r + 1, rows - 1)
    b = rhs[r % rhs.shape[0]]
    if across is None:
        unit_residual_row(z[up % n], z[r % n], z[low % n], b, out)
    else:
        a, u, d = across[r % across.shape[0]], down[r % down.shape[0]], down[(r + 1) % down.shape[0]]
        residual_row(z[up % n], z[r % n], z[low % n], b, a, u, d, out)
