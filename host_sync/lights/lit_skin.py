"""Skin that all lamps reach: rays to them clear it by enough."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.lights.lamp_model import LampModel

PENUMBRA: Final = 0.3
"""A light may be hidden in part where the tangent of its elevation clears the skin by less."""

OBSTRUCTED: Final = 0.85
"""The same as a share of what clears level skin: a lamp that stands low is not hidden for that."""

GRAZED: Final = (0.03, 0.09)
"""Tangents by which the ray to a light clears the skin: up to the first the light is not counted on, from the second it
is. Lamps are not points, and cells round edges off."""

Pixels = Float32Array | Float64Array


def may_be_hidden(clear: Pixels, level: Float64Array) -> MaskArray:
    """Where a light may be hidden: arrays of one shape.

    clear : tangent by which the ray to the light clears the skin
    level : the same of level skin, which is the tangent of the light's elevation
    """
    return np.asarray(clear < np.minimum(PENUMBRA, OBSTRUCTED * level))


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
        lit &= clear >= np.minimum(GRAZED[1], OBSTRUCTED * above / distance)
    return lit
