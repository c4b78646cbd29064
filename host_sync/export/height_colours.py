"""Colours of heights: the tints of our pictures, from the lowest to the highest percent."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from host_sync.export.mesh import ROWS, Mesh
from host_sync.render.tints import tint_table


def vertex_colours(mesh: Mesh) -> Iterator[NDArray[np.uint8]]:
    """Colours of the vertices in order, some at a time: uint8 arrays of shape (N, 3), sRGB."""
    low, high = np.nanpercentile(mesh.z_um, [1.0, 99.0])
    span = float(high - low) or 1.0
    palette = np.rint(tint_table()).astype(np.uint8)
    for first in range(0, mesh.z_um.shape[0], ROWS):
        z = mesh.z_um[first : first + ROWS]
        shade = np.clip((z[np.isfinite(z)] - low) / span * 255.0, 0.0, 255.0)
        yield palette[np.rint(shade).astype(np.uint8)]


def linear_light(colours: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """The same in linear light, uint16 array of shape (N, 3), 65535 is full."""
    share = np.arange(256) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    table: NDArray[np.uint16] = np.rint(linear * 65535.0).astype(np.uint16)
    return table[colours]
