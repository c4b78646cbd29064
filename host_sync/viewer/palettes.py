"""Colours of numbers, each readable without colour vision: lightness alone tells high from low."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from host_sync.render.tints import tint_table

_ENTRIES: Final = 256
_DIVERGING: Final = (
    (24, 58, 110),
    (84, 132, 188),
    (178, 206, 228),
    (246, 246, 244),
    (240, 196, 150),
    (206, 116, 48),
    (122, 52, 8),
)
"""Blue is below, orange above, white is nought: these two hues differ to every eye."""


def palettes() -> dict[str, list[list[int]]]:
    """R, G, B (0 to 255) of 256 steps from low to high, by name; the first is the one of every relief."""
    ramp = np.arange(_ENTRIES, dtype=np.uint8)[:, None]
    found = {"relief": tint_table(_ENTRIES)}
    for name, code in (("cividis", cv2.COLORMAP_CIVIDIS), ("viridis", cv2.COLORMAP_VIRIDIS)):
        found[name] = np.asarray(cv2.applyColorMap(ramp, code)[:, 0, ::-1], np.float32)
    found["grey"] = np.repeat(np.linspace(30.0, 245.0, _ENTRIES, dtype=np.float32)[:, None], 3, axis=1)
    at = np.linspace(0.0, len(_DIVERGING) - 1.0, _ENTRIES)
    ends = np.arange(len(_DIVERGING))
    found["difference"] = np.stack(
        [np.interp(at, ends, [colour[k] for colour in _DIVERGING]) for k in range(3)], axis=-1
    ).astype(np.float32)
    return {name: np.round(colours).astype(int).tolist() for name, colours in found.items()}
