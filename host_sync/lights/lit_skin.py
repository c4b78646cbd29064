"""Skin that all lamps reach: rays to them clear it by enough."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.lights.half_shadow_kernel import OBSTRUCTED
from host_sync.lights.lamp_model import LampModel

GRAZED: Final = 0.09
"""Tangent by which the ray to a light clears the skin from which on it is counted on: lamps are not points."""

Pixels = Float32Array | Float64Array


def is_lit_by_all(model: LampModel, p: Pixels, q: Pixels, column: Pixels, row: Pixels) -> MaskArray:
    """Where every lamp is counted on for all that the skin's own slope hides: bool array of the arguments' shape.

    p, q : slopes at the pixels `column`, `row`, at the elevation of untouched skin
    """
    rows, columns = model.shape
    x, y = (column - 0.5 * (columns - 1)) / columns, (row - 0.5 * (rows - 1)) / columns
    lit = np.ones(x.shape, np.bool_)
    for right, down, above in model.position:
        across, along = right - x, down - y
        distance = np.maximum(np.hypot(across, along), 1e-6)
        clear = (above - p * across - q * along) / distance
        lit &= clear >= np.minimum(GRAZED, OBSTRUCTED * above / distance)
    return lit
