"""Lamps whose places over the skin are known: from a board profile, or stated in a frame set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from device.surface.fields import Float32Array, Float64Array

Position = tuple[float, float, float]
"""Right, down and up from the middle of the field on untouched skin, mm."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownLamps:
    """Where the lamp of each channel stands.

    position_px : float64 array of shape (3, 3), by channel right, down and up from the middle of the field, pixels
    """

    position_px: Float64Array

    @classmethod
    def of(cls, positions_mm: Sequence[Position], pitch_um: float) -> KnownLamps:
        """Lamps at these positions (mm) over skin whose pixels are `pitch_um` apart."""
        return cls(np.asarray(positions_mm, np.float64) * (1e3 / pitch_um))

    def slants(self, z_px: Float32Array, cell: int, shape: tuple[int, int]) -> Float64Array:
        """Away from each lamp, as long as the tangent of its zenith angle: shape (h, w, 3, 2).

        z_px : elevation of cells of `cell` x `cell` pixels of a field of `shape` (H, W), shape (h, w)
        """
        row, column = (
            np.arange(count) * cell + 0.5 * (cell - size) for count, size in zip(z_px.shape, shape, strict=True)
        )
        x, y = np.meshgrid(column, row)
        away = np.stack([x, y], axis=-1)[..., None, :] - self.position_px[:, :2]
        up = np.maximum(self.position_px[:, 2] - z_px[..., None], 1.0)
        return np.asarray(away / up[..., None])

    def level_skin_raised(
        self, place_px: Float64Array, z_px: Float64Array, shape: tuple[int, int]
    ) -> tuple[Float64Array, Float64Array]:
        """How level matt skin at an elevation looks to what expects it untouched.

        place_px : columns and rows in a field of `shape` (H, W), shape (N, 2)
        z_px : elevation over untouched skin, shape (N,)

        Returns
        -------
        float64 array of shape (N, 2), the slope towards which it seems to rise; of shape (N,), the brightening that all
        channels share, relative
        """
        middle = 0.5 * (np.array(shape[::-1], np.float64) - 1.0)
        across = self.position_px[None, :, :2] - (place_px - middle)[:, None, :]
        height = self.position_px[None, :, 2]
        above = np.maximum(height - z_px[:, None], 1.0)
        change = _irradiance(across, above) / _irradiance(across, height) - 1.0
        shading = np.concatenate([-across / above[..., None], np.ones((*above.shape, 1))], axis=-1)
        found = np.linalg.solve(shading, change[..., None])[..., 0]
        return found[:, :2], found[:, 2]


def _irradiance(across_px: Float64Array, above_px: Float64Array) -> Float64Array:
    """Of level skin by a lamp that shines alike in all directions, shapes (..., 2) and (...)."""
    return np.asarray(above_px / ((across_px**2).sum(axis=-1) + above_px**2) ** 1.5)
