"""Relief of a height map: diffuse shading, coloured by height."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, HeightMap
from host_sync.kernels.jit import njit
from host_sync.render.colormap import HIGHLIGHT, tint_table
from host_sync.render.shading import flat_brightness, shade

Picture = NDArray[np.uint8]

INVALID: Final = 255


def relief_rgb(height: HeightMap, low_um: float, high_um: float, exaggeration: float = 1.0) -> Picture:
    """Picture of shape (H, W, 3): colour by height, shaded; white where a pixel or a neighbour is invalid.

    low_um, high_um : heights of the first and last colour, µm
    exaggeration : factor on the slopes for shading
    """
    return tinted(height, shade(height, exaggeration=exaggeration), flat_brightness(), low_um, high_um)


def tinted(height: HeightMap, brightness: Float32Array, flat: float, low_um: float, high_um: float) -> Picture:
    """Picture of shape (H, W, 3): colour by height, darker or lighter than on a flat surface by its brightness.

    brightness : float32 array of shape (H, W), 0 to 1; NaN becomes white
    flat : brightness of a flat surface under the same light
    """
    picture = np.empty((*height.z_um.shape, 3), np.uint8)
    share = np.float32(1.0 / max(high_um - low_um, 1e-9))
    low = np.float32(low_um)
    _tint(np.ascontiguousarray(height.z_um), brightness, low, share, np.float32(flat), tint_table(), picture)
    return picture


def height_range_um(height: HeightMap) -> tuple[float, float]:
    """0.1 and 99.9 percentile of the valid heights, µm; (0, 1) when none is valid."""
    step = max(1, height.z_um.shape[1] // 300)
    sample = height.z_um[::step, ::step]
    finite = sample[np.isfinite(sample)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, [0.1, 99.9])
    return float(low), float(max(high, low + 1e-3))


@njit(cache=True, nogil=True)
def _tint(z_um: Any, brightness: Any, low: Any, share: Any, flat: Any, table: Any, picture: Any) -> None:
    """Write the picture, without the interpreter lock."""
    rows, columns = z_um.shape
    zero, one, last = np.float32(0.0), np.float32(1.0), np.float32(table.shape[0] - 1)
    white, highlight = np.float32(255.0), np.float32(HIGHLIGHT)
    for r in range(rows):
        for c in range(columns):
            light = brightness[r, c]
            at = (z_um[r, c] - low) * share
            if not (np.isfinite(light) and np.isfinite(at)):
                picture[r, c, :] = INVALID
                continue
            entry = np.int64(min(max(at, zero), one) * last + np.float32(0.5))
            darker = min(light / flat, one)
            lighter = highlight * max(light - flat, zero) / (one - flat)
            for k in range(3):
                shaded = table[entry, k] * darker
                picture[r, c, k] = np.uint8(shaded + (white - shaded) * lighter)
