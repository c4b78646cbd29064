"""The root of intensity as what a curve reads: shot noise is even in it, and shadows are not stretched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class RootIntensity:
    """Makes the root of intensity of intensity; it is the same at every place."""

    def seen(self, intensity: Float32Array, _place: NDArray[Any]) -> Float32Array:
        """Roots of intensities (N, 3)."""
        return np.sqrt(np.maximum(intensity, np.float32(0.0)))

    def seen_rows(self, values: Float32Array, _across: Float32Array, _down: Float32Array) -> Float32Array:
        """The same of whole rows (h, w, 3)."""
        return np.sqrt(np.maximum(values, np.float32(0.0)))
