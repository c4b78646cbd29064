"""Evidence of skin at rest in frame after frame: what depends on the calibration alone is computed once."""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property
from typing import Self

import numpy as np

from device.inverse_map.skin_at_rest import CELLS_ALIKE, SkinAtRest
from device.surface.fields import Float32Array, Float64Array, MaskArray


class FrameRest(SkinAtRest):
    """The light of untouched skin, kept in the form in which gains and offsets of a frame are fitted."""

    @classmethod
    def like(cls, at_rest: SkinAtRest) -> Self:
        """Return that of a calibration."""
        return cls(*(getattr(at_rest, field.name) for field in fields(SkinAtRest)))

    @cached_property
    def _lit(self) -> MaskArray:
        return np.asarray(super()._lit)

    @cached_property
    def _contrast(self) -> Float32Array:
        return np.asarray(super()._contrast)

    @cached_property
    def _moments(self) -> Float64Array:
        """Precision of lit cells, times 1, contrast and its square: float64 array of shape (3, 3, cells)."""
        contrast = self._contrast.reshape(-1, 3).T.astype(np.float64)
        variance = CELLS_ALIKE * np.einsum("...ii->i...", self.covariance).reshape(3, -1)
        return np.asarray(self._lit.ravel() / variance * np.stack([np.ones_like(contrast), contrast, contrast**2]))

    def _levels(self, logs: Float32Array, weight: Float64Array) -> tuple[Float64Array, Float64Array]:
        one, once, twice = self._moments @ weight.ravel()
        seen = weight.ravel() * logs.reshape(-1, 3).T
        level, slope = ((moment * seen).sum(axis=1) for moment in self._moments[:2])
        one, twice = one + self.gain_sigma**-2, twice + self.offset_sigma**-2
        determinant = one * twice - once * once
        return (twice * level - once * slope) / determinant, (one * slope - once * level) / determinant
