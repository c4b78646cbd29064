"""The difference of two height maps of the same pixels, such as a result and the maker's own map of the same scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float64Array, HeightMap, MaskArray
from host_sync.errors import MeasurementError

SAME_PITCH: Final = 0.01
LEAST_SHARE: Final = 0.01
DEPTH_PERCENTILES: Final = (0.5, 99.5)
"""Depth is from one to the other: single pixels do not count."""


@dataclass(frozen=True, slots=True)
class MapDifference:
    """Rms and mean of the absolute difference about its mean plane, depth of the other map (µm), share compared."""

    rms_um: float
    mean_um: float
    depth_um: float
    compared: float

    @property
    def percent_of_depth(self) -> float | None:
        """The rms in percent of the depth; None of a flat map."""
        return 100.0 * self.rms_um / self.depth_um if self.depth_um > 0.0 else None


def map_difference(height: HeightMap, other: HeightMap) -> MapDifference:
    """The difference of `height` to `other`, pixel by pixel; a plane is taken off, as two datums differ by one.

    Raises
    ------
    MeasurementError
        The maps have other sizes or pitches, or hardly a pixel in common.
    """
    if height.z_um.shape != other.z_um.shape:
        (rows, columns), (other_rows, other_columns) = height.z_um.shape, other.z_um.shape
        raise MeasurementError(
            f"the maps have {columns}x{rows} and {other_columns}x{other_rows} pixels: compare maps of the same scan"
        )
    if abs(height.pitch_um - other.pitch_um) > SAME_PITCH * other.pitch_um:
        raise MeasurementError(
            f"the maps have pixels of {height.pitch_um:g} and {other.pitch_um:g} µm: compare maps of the same scan"
        )
    both = np.asarray(np.isfinite(height.z_um) & np.isfinite(other.z_um))
    if both.mean() < LEAST_SHARE:
        raise MeasurementError("the maps have hardly a valid pixel in common: compare maps of the same scan")
    off = _without_plane(height.z_um.astype(np.float64) - other.z_um, both)
    low, high = np.percentile(_without_plane(other.z_um.astype(np.float64), both), DEPTH_PERCENTILES)
    rms, mean = float(np.sqrt(np.mean(off**2))), float(np.mean(np.abs(off)))
    return MapDifference(rms, mean, float(high - low), float(both.mean()))


def _without_plane(values: Float64Array, where: MaskArray) -> Float64Array:
    """The values there less the plane that fits them, float64 array of shape (N,)."""
    row, column = np.nonzero(where)
    scale = float(max(values.shape))
    design = np.stack([column / scale, row / scale, np.ones(len(row))], axis=-1)
    taken = values[where]
    normal = design.T @ design
    return np.asarray(taken - design @ np.linalg.lstsq(normal, design.T @ taken, rcond=None)[0])
