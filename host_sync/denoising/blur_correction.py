"""Correction of the camera's blur, as far as every camera has it.

A blur of standard deviation s takes ½ s² ∇²z from heights, to first order: of a wave of 20 px 1.2 % with s = 0.5 px, of
one of 10 px 5 %. A pixel's own square has 0.29 px; a lens that suits its pixels makes 0.5 px of it, and more is not
known: what may be lost beyond that is in the uncertainty (`calibration_uncertainty`). Only the surface with shrunk
detail is corrected, and only of quiet sensors: noise grows by an eighth.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from device.surface import HeightMap
from host_sync.integration.smoother import CONTRACT
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

BLUR_PX: Final = 0.5
"""Standard deviation of the blur that is taken out."""

MAX_NOISE_DEG: Final = 0.2
"""Noise of the surface's slopes up to which it is.

A real sensor with 0.38° loses 0.03° of accuracy by it, one with 0.1° nothing.
"""

REACH: Final = 2
"""Pixels between the points of a second difference: those see little of the noise from pixel to pixel."""


def without_blur(height: HeightMap, blur_px: float) -> HeightMap:
    """Return the height map less the Laplacian that a blur added; unchanged next to invalid pixels.

    blur_px : standard deviation of the blur; 0 takes nothing out
    """
    if blur_px == 0.0:
        return height
    z_um = np.ascontiguousarray(height.z_um, np.float32)
    out = np.empty_like(z_um)
    parallel_rows(_write_without, z_um.shape, z_um, np.float32(0.5 * blur_px**2 / REACH**2), out)
    return HeightMap(out, height.pitch_um)


@njit(cache=True, nogil=True)
def _write_without(z: Any, share: Any, out: Any, first: int, last: int) -> None:
    """Write rows less a share of their Laplacian; beyond the border the outermost pixels repeat."""
    rows, columns = z.shape
    for r in range(first, last):
        above, here, below = z[max(r - REACH, 0)], z[r], z[min(r + REACH, rows - 1)]
        end = max(columns - REACH, REACH)
        if end > REACH:
            inner = slice(REACH, end)
            left, right = here[: end - REACH], here[2 * REACH :]
            _write_inner(above[inner], left, here[inner], right, below[inner], share, out[r, inner])
        for c in range(columns):
            if c < REACH or c >= end:
                left_z, right_z = here[max(c - REACH, 0)], here[min(c + REACH, columns - 1)]
                out[r, c] = _less_bend(share * above[c], left_z, here[c], right_z, below[c], share)


@njit(cache=True)
def _write_inner(above: Any, left: Any, here: Any, right: Any, below: Any, share: Any, out: Any) -> None:
    for c in range(out.size):
        out[c] = _less_bend(share * above[c], left[c], here[c], right[c], below[c], share)


@njit(cache=True, fastmath=CONTRACT)
def _less_bend(begun: Any, left: Any, here: Any, right: Any, below: Any, share: Any) -> Any:
    """Return a height less its share of the Laplacian; unchanged where a neighbour is no number.

    begun : the share of the height above, rounded by itself, so that every pixel's terms are added alike
    """
    middle = np.float32(-4.0) * share
    bend = share * below + (share * right + (middle * here + (share * left + begun)))
    return here - (bend if np.isfinite(bend) else np.float32(0.0))
