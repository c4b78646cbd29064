"""Footprint of a measurand on the field: points all over it, for the doubts that hold for parts of the field."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from device.surface.fields import Float64Array, MaskArray
from host_sync.measurement.geometry import Region
from host_sync.profile.profile_line import Line

ALONG: Final = 64
ACROSS: Final = 8


def field_places(shape: tuple[int, int]) -> Float64Array:
    """Row and column, px, of points all over a field of `shape` (H, W): float64 array of shape (N, 2)."""
    return _grid(0.0, 0.0, shape[0] - 1.0, shape[1] - 1.0)


def region_places(regions: Iterable[Region], pitch_um: float) -> Float64Array:
    """Row and column, px, of points all over the regions: float64 array of shape (N, 2)."""
    parts = [
        _grid(*(place / pitch_um for place in (one.top_um, one.left_um, one.bottom_um, one.right_um)))
        for one in regions
    ]
    return np.concatenate(parts)


def line_places(line: Line, pitch_um: float) -> Float64Array:
    """Row and column, px, of points all over a line of some width: float64 array of shape (N, 2)."""
    start, end = (np.array(place[::-1]) / pitch_um for place in (line.start_um, line.end_um))
    along = np.linspace(start, end, ALONG)
    way = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
    offsets = np.linspace(-0.5, 0.5, ACROSS if line.width_um else 1) * line.width_um / pitch_um
    places = along[:, None] + offsets[:, None] * np.array([-way[1], way[0]])
    return np.asarray(places.reshape(-1, 2), np.float64)


def share_at(mask: MaskArray | None, places: Float64Array) -> float | None:
    """Fraction of the places at which a mask of shape (H, W) holds; None without a mask."""
    if mask is None:
        return None
    row, column = (np.clip(np.rint(places[:, axis]), 0, mask.shape[axis] - 1).astype(np.intp) for axis in (0, 1))
    return float(mask[row, column].mean())


def reaches_beyond(shape: tuple[int, int], places: Float64Array) -> bool:
    """Return whether places lie more than a pixel outside of a field of `shape` (H, W)."""
    return bool(len(places) and ((places < -1.0) | (places > shape)).any())


def _grid(top: float, left: float, bottom: float, right: float) -> Float64Array:
    row, column = np.meshgrid(np.linspace(top, bottom, ALONG), np.linspace(left, right, ALONG), indexing="ij")
    return np.stack([row.ravel(), column.ravel()], axis=-1)
