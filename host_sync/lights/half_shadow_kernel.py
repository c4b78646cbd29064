"""Rays from cells to the points of lamps, cell by cell: the kernel of `arriving_light`."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from host_sync.kernels.jit import njit

TURNING: Final = 0.3
"""A light may be hidden where the tangent of its elevation clears a cell's own plane by less."""

NEAR_SHADOW: Final = 0.15
"""The same of other skin on the way, whose height is not sure."""

OBSTRUCTED: Final = 0.85
"""Share of what clears level skin that bounds these tangents: a lamp that stands low is not hidden for that."""

HALF_SHADOW: Final = 0.05
"""Tangent by which the ray to a point of a lamp clears cells where all of its light arrives, and by which it fails to
where none does: lamps are not points, and cells round edges off."""

OVER_OWN_PLANE: Final = 0.05
"""Tangent by which skin on the way stands over a cell's own plane where it hides as much of a light as rays say; twice
as much changes near, low and short by up to 0.02 µm."""

TURNED_AWAY: Final = 0.06
"""Tangent by which a light stands over a cell's own plane from which on it counts in full: what is dark there tells
only that the skin turns away. With 0.03 to 0.09 instead the twin's ball is read 0.5 % too steep (decision 0034)."""

STRIDE: Final = 4
"""Cells that a ray passes at once where no skin around comes near it: twice as fast as one by one; 8 is no faster."""


@njit(cache=True, nogil=True, error_model="numpy")
def write_arriving(
    z: Any, p: Any, q: Any, around: Any, places: Any, shares: Any, grid: Any, hidden: Any, visible: Any, facing: Any,
    first: int, last: int,
) -> None:  # fmt: skip
    """Write what arrives of lamps into the rows `first` to `last` - 1 of `hidden`, `visible` and `facing`.

    z, p, q : elevation of cells, pixels, and its slopes, shape (h, w); finite
    around : the highest of cells up to `STRIDE` + 1 rows and columns away, shape (h, w)
    places : of each lamp's points, pixels from the middle of the field, shape (3, points, 3)
    shares : of a lamp's light that its points have, shape (points,)
    grid : pixels along a cell; column and row of the middle of the first one from the middle of the field
    hidden : bool array of shape (h, w, 3)
    visible : shape (h, w, 3, points)
    facing : shape (h, w, 3)
    """
    cell, left, upper = grid
    rows, columns = z.shape
    top = float(around.max())
    for i in range(first, last):
        for j in range(columns):
            own_z, x, y = z[i, j], left + j * cell, upper + i * cell
            for lamp in range(places.shape[0]):
                hidden[i, j, lamp], facing[i, j, lamp] = False, 0.0
                for point in range(places.shape[1]):
                    across, down = places[lamp, point, 0] - x, places[lamp, point, 1] - y
                    distance = max(np.sqrt(across * across + down * down), 1e-3)
                    across, down = across / distance, down / distance
                    rise = max(places[lamp, point, 2] - own_z, 1.0) / distance
                    own = rise - (p[i, j] * across + q[i, j] * down)
                    clear, step = np.inf, 1
                    # Farther on even the highest skin comes near no ray.
                    while step * cell < distance and rise - (top - own_z) / (step * cell) < min(clear, NEAR_SHADOW):
                        column, row = j + step * across, i + step * down
                        if not (0.0 <= column <= columns - 1 and 0.0 <= row <= rows - 1):
                            break
                        c, r = min(int(column), columns - 2), min(int(row), rows - 2)
                        if max(around[r, c] - own_z, 0.0) <= (rise - min(clear, NEAR_SHADOW)) * step * cell:
                            step += STRIDE
                            continue
                        u, v = column - c, row - r
                        met = (1.0 - v) * ((1.0 - u) * z[r, c] + u * z[r, c + 1])
                        met += v * ((1.0 - u) * z[r + 1, c] + u * z[r + 1, c + 1])
                        clear = min(clear, rise - (met - own_z) / (step * cell))
                        step += 1
                    passes = min(max((clear + HALF_SHADOW) / (2.0 * HALF_SHADOW), 0.0), 1.0)
                    in_the_way = min(max((own - clear) / OVER_OWN_PLANE, 0.0), 1.0)
                    visible[i, j, lamp, point] = 1.0 - (1.0 - passes) * in_the_way
                    level = OBSTRUCTED * rise
                    facing[i, j, lamp] += shares[point] * min(max(own / min(TURNED_AWAY, level), 0.0), 1.0)
                    hidden[i, j, lamp] |= own < min(TURNING, level) or clear < min(NEAR_SHADOW, level)
