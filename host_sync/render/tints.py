"""The colours of heights, from low to high."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.surface import Float32Array

TINTS: Final = ((48, 68, 112), (66, 108, 138), (108, 148, 148), (168, 181, 150), (214, 199, 152), (241, 226, 194))
"""R, G, B from low to high: dark blue to light sand, readable without colour vision, pale enough to be shaded."""

HIGHLIGHT: Final = 0.55
"""How far the brightest slope goes from its tint towards white."""


def tint_table(entries: int = 256) -> Float32Array:
    """Colours of equally spaced heights from low to high: float32 array of shape (entries, 3), 0 to 255."""
    at = np.linspace(0.0, len(TINTS) - 1.0, entries)
    columns = [np.interp(at, np.arange(len(TINTS)), [tint[k] for tint in TINTS]) for k in range(3)]
    return np.stack(columns, axis=-1).astype(np.float32)
