"""The slope error of several groups of lights read together, from that of the first and what joining them changes.

Both are measured on the same balls with the same maps; what the first group's error holds besides, held-out inflation
and elevation, stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import Float32Array, Float64Array
from host_sync.uncertainty.slope_error import SlopeError, error_by_tilt

CHANNELS: Final = 3
LEAST_SHARE: Final = 0.3
"""Joining groups is not trusted to lessen an error by more."""


@dataclass(frozen=True, slots=True)
class JoinedMaps:
    """The mean of several inverse maps, each of which reads three channels of its own."""

    maps: tuple[InverseMap, ...]

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Return slopes p and q, float64 array of shape (N, 2), of intensities of shape (N, 3 times the groups)."""
        parts = [
            one.predict(np.ascontiguousarray(intensity[:, CHANNELS * i : CHANNELS * (i + 1)]), column, row)
            for i, one in enumerate(self.maps)
        ]
        return np.asarray(np.mean(parts, axis=0), np.float64)


def joined_slope_error(
    first: SlopeError, images: Sequence[Sequence[NormalizedImage]], balls: Sequence[Sequence[Ball]], maps: JoinedMaps
) -> SlopeError:
    """Return the slope error of the groups' mean.

    first : of the first group
    images : of every press, its intensity by group
    balls : of every press
    """
    together = [(_beside(groups), own) for groups, own in zip(images, balls, strict=True)]
    alone = error_by_tilt([(image, own) for image, own in together], JoinedMaps(maps.maps[:1]))
    joined = error_by_tilt(together, maps)
    shares = [
        np.clip(
            np.interp(first.tilt_deg, joined.tilt_deg, after)
            / np.maximum(np.interp(first.tilt_deg, alone.tilt_deg, before), 1e-9),
            LEAST_SHARE,
            None,
        )
        for before, after in ((alone.pixel_deg, joined.pixel_deg), (alone.patch_deg, joined.patch_deg))
    ]
    return msgspec.structs.replace(
        first,
        pixel_deg=tuple(float(value) for value in shares[0] * first.pixel_deg),
        patch_deg=tuple(float(value) for value in shares[1] * first.patch_deg),
    )


def _beside(groups: Sequence[NormalizedImage]) -> NormalizedImage:
    """Return the intensities of all groups side by side: valid where all are, clipped where one is."""
    return NormalizedImage(
        np.concatenate([image.values for image in groups], axis=-1),
        np.logical_and.reduce([image.valid for image in groups]),
        np.logical_or.reduce([image.clipped for image in groups]),
    )
