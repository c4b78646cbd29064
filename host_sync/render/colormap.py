"""Colormaps of heights; each is readable without colour vision, because lightness alone separates high from low."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array

TINTS: Final = ((48, 68, 112), (66, 108, 138), (108, 148, 148), (168, 181, 150), (214, 199, 152), (241, 226, 194))
"""R, G, B from low to high: dark blue to light sand, pale enough for shading."""

HIGHLIGHT: Final = 0.55
"""Fraction of the way from its tint to white at the brightest slope."""


def tint_table(entries: int = 256) -> Float32Array:
    """R, G, B of equally spaced heights, low to high: float32 array of shape (entries, 3), 0 to 255."""
    at = np.linspace(0.0, len(TINTS) - 1.0, entries)
    columns = [np.interp(at, np.arange(len(TINTS)), [tint[k] for tint in TINTS]) for k in range(3)]
    return np.stack(columns, axis=-1).astype(np.float32)


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
"""Blue below zero, white at zero, orange above: hues that everyone can tell apart."""


def palettes() -> dict[str, list[list[int]]]:
    """R, G, B (0 to 255) of 256 steps from low to high, by name; the first is that of the reliefs."""
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


def linear_light(colours: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """sRGB colours in linear light: uint16 array of shape (N, 3), 65535 is full."""
    srgb = np.arange(256) / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    table: NDArray[np.uint16] = np.rint(linear * 65535.0).astype(np.uint16)
    return table[colours]
