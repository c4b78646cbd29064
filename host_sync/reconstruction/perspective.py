"""Heights on the grid of pixels that a camera nearby sees, from slopes of the skin itself.

A camera at the height h sees skin of slope (p, q) and elevation z, over the place (x, y) from the middle, at
(x, y) / (1 - z / h). On its pixels heights rise by (p, q) (1 - z / h) / (1 + (x p + y q) / h). Integrated without the
first factor they are -h log(1 - z / h), so that neither needs to be known beforehand.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from device.balls.viewpoint import Viewpoint
from device.surface.fields import Float32Array, GradientField, HeightMap
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

MIN_FACING: Final = 0.2
"""Skin that faces the camera less than this share of what level skin does is taken to face it so much: at 0 it would
be seen edge on, and no height map holds what lies behind."""


def seen_slopes(
    gradients: GradientField, viewpoint: Viewpoint, height: HeightMap | None = None, out: GradientField | None = None
) -> GradientField:
    """Return how steeply heights rise over pixels, of skin with these slopes; without heights less the factor of
    elevation.

    height : over untouched skin, arrays of shape (H, W); where it is not known skin counts as untouched
    out : receives p and q; may be `gradients`
    """
    p, q = (np.empty_like(gradients.p), np.empty_like(gradients.q)) if out is None else (out.p, out.q)
    z_um = np.empty((0, 0), np.float32) if height is None else height.z_um
    pitch_um = np.float32(1.0 if height is None else height.pitch_um)
    place = np.array([viewpoint.column, viewpoint.row, 1.0 / viewpoint.height_px], np.float32)
    parallel_rows(_write_seen, p.shape, gradients.p, gradients.q, z_um, pitch_um, place, p, q)
    return replace(gradients, p=p, q=q)


def seen_elevation(height: HeightMap, viewpoint: Viewpoint, out: Float32Array | None = None) -> HeightMap:
    """Return heights over untouched skin, from those that slopes without the factor of elevation add up to.

    out : receives the heights; may be those given
    """
    z_um = np.empty_like(height.z_um) if out is None else out
    nearness = np.float32(1.0 / (viewpoint.height_px * height.pitch_um))
    parallel_rows(_write_elevation, z_um.shape, height.z_um, nearness, z_um)
    return HeightMap(z_um, height.pitch_um)


@njit(cache=True, nogil=True)
def _write_seen(
    p: Any, q: Any, z: Any, pitch: Any, place: Any, seen_p: Any, seen_q: Any, first: int, last: int
) -> None:
    column, row, nearness = place
    one, least = np.float32(1.0), np.float32(MIN_FACING)
    for r in range(first, last):
        y = (np.float32(r) - row) * nearness
        for c in range(p.shape[1]):
            x = (np.float32(c) - column) * nearness
            share = one / max(one + x * p[r, c] + y * q[r, c], least)
            if z.size:
                elevation = z[r, c] / pitch
                share *= one - (elevation if elevation == elevation else np.float32(0.0)) * nearness
            seen_p[r, c] = share * p[r, c]
            seen_q[r, c] = share * q[r, c]


@njit(cache=True, nogil=True)
def _write_elevation(z: Any, nearness: Any, out: Any, first: int, last: int) -> None:
    for r in range(first, last):
        for c in range(z.shape[1]):
            out[r, c] = -np.expm1(-z[r, c] * nearness) / nearness
