"""Shading of a height map under one light, with cast shadows and ambient occlusion, and its colours by height."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, HeightMap
from host_sync.kernels.jit import njit

LIGHT_AZIMUTH_DEG: Final = 135.0
LIGHT_ELEVATION_DEG: Final = 40.0
AMBIENT: Final = 0.15

PLEASANT_SLOPE: Final = 0.35
"""Slope with good contrast; flatter reliefs are exaggerated up to it."""

MAX_EXAGGERATION: Final = 20.0
STEEP_PERCENTILE: Final = 97.0


def shade(
    height: HeightMap,
    azimuth_deg: float = LIGHT_AZIMUTH_DEG,
    elevation_deg: float = LIGHT_ELEVATION_DEG,
    exaggeration: float = 1.0,
) -> Float32Array:
    """Return the brightness of a white diffuse surface: float32 array (H, W), 0 to 1, NaN beside invalid pixels.

    azimuth_deg : azimuth of the light, counter-clockwise from the right edge of the picture; 135 is the upper left
    elevation_deg : elevation of the light above the plane
    exaggeration : factor on the slopes
    """
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    # Rows grow downwards, so that a light at the top of the picture has a negative row component.
    light = np.array([np.cos(azimuth), -np.sin(azimuth), np.tan(elevation)]) * np.cos(elevation)
    brightness = np.empty(height.z_um.shape, np.float32)
    per_pixel = np.float32(exaggeration / height.pitch_um)
    _shade(np.ascontiguousarray(height.z_um), per_pixel, light.astype(np.float32), brightness)
    return brightness


def flat_brightness(elevation_deg: float = LIGHT_ELEVATION_DEG) -> float:
    """Return the brightness of a flat surface."""
    return float(AMBIENT + (1.0 - AMBIENT) * np.sin(np.radians(elevation_deg)))


def steep_slope(height: HeightMap, samples: int = 250) -> float:
    """97th percentile of the slope, from about `samples` columns; 0 when no pixel is valid."""
    step = max(1, height.z_um.shape[1] // samples)
    here = height.z_um[:-1:step, :-1:step]
    across, down = height.z_um[:-1:step, 1::step], height.z_um[1::step, :-1:step]
    steepness = np.hypot(across - here, down - here) / height.pitch_um
    finite = steepness[np.isfinite(steepness)]
    return float(np.percentile(finite, STEEP_PERCENTILE)) if finite.size else 0.0


def exaggeration_for(steep: float) -> float:
    """Return the factor on slopes for good contrast: an integer, 1 for slopes as steep as a ball's."""
    return float(np.clip(np.round(PLEASANT_SLOPE / max(steep, 1e-6)), 1.0, MAX_EXAGGERATION))


def reduced(height: HeightMap, widest_px: int) -> HeightMap:
    """Return the height map averaged down to at most `widest_px` columns.

    A pixel with an invalid part becomes invalid.
    """
    columns = height.z_um.shape[1]
    factor = int(np.ceil(columns / widest_px))
    if factor <= 1:
        return height
    rows, columns = (size // factor * factor for size in height.z_um.shape)
    size = (columns // factor, rows // factor)
    small = cv2.resize(height.z_um[:rows, :columns], size, interpolation=cv2.INTER_AREA)
    return HeightMap(np.asarray(small, np.float32), height.pitch_um * factor)


@njit(cache=True, nogil=True, error_model="numpy")
def _shade(z_um: Any, per_pixel: Any, light: Any, brightness: Any) -> None:
    """Write the brightness; slopes are central differences, one-sided at the borders."""
    rows, columns = z_um.shape
    ambient, one, zero = np.float32(AMBIENT), np.float32(1.0), np.float32(0.0)
    for r in range(rows):
        above, below = max(r - 1, 0), min(r + 1, rows - 1)
        down = per_pixel / np.float32(max(below - above, 1))
        for c in range(columns):
            before, after = max(c - 1, 0), min(c + 1, columns - 1)
            p = (z_um[r, after] - z_um[r, before]) * per_pixel / np.float32(max(after - before, 1))
            q = (z_um[below, c] - z_um[above, c]) * down
            cosine = (light[2] - p * light[0] - q * light[1]) / np.sqrt(one + p * p + q * q)
            brightness[r, c] = ambient + (one - ambient) * max(zero, cosine)


Picture = NDArray[np.uint8]

INVALID: Final = 255


def relief_rgb(height: HeightMap, low_um: float, high_um: float, exaggeration: float = 1.0) -> Picture:
    """Return the picture of shape (H, W, 3): colour by height, shaded; white where a pixel or a neighbour is invalid.

    low_um, high_um : heights of the first and last colour, µm
    exaggeration : factor on the slopes for shading
    """
    return tinted(height, shade(height, exaggeration=exaggeration), flat_brightness(), low_um, high_um)


def tinted(height: HeightMap, brightness: Float32Array, flat: float, low_um: float, high_um: float) -> Picture:
    """Return the picture (H, W, 3): colour by height, darker or lighter than on a flat surface by its brightness.

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


DIRECTIONS: Final = 16
REACH_FRACTION: Final = 0.15
"""Reach of ambient occlusion, as a fraction of the height map's diagonal."""

SHADOW_SOFTNESS: Final = 0.06
"""Width of the penumbra, as a tangent of the elevation."""


def ambient_occlusion(height: HeightMap, exaggeration: float) -> Float32Array:
    """Return the fraction of a diffuse sky that each pixel sees: float32 array of shape (H, W), NaN where invalid."""
    total = np.zeros(height.z_um.shape, np.float32)
    for turn in np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS):
        tangent = _horizon(height, exaggeration, float(turn), REACH_FRACTION)
        total += 1.0 / (1.0 + np.maximum(tangent, np.float32(0.0)) ** 2)
    return np.where(np.isfinite(height.z_um), total / np.float32(DIRECTIONS), np.float32(np.nan))


def shadow_mask(height: HeightMap, exaggeration: float, azimuth_deg: float, elevation_deg: float) -> Float32Array:
    """Return the fraction of the light that reaches each pixel: float32 array of shape (H, W), 0 to 1."""
    tangent = _horizon(height, exaggeration, float(np.radians(azimuth_deg)), 1.0)
    free = (np.float32(np.tan(np.radians(elevation_deg))) - tangent) / np.float32(SHADOW_SOFTNESS)
    return np.asarray(np.clip(free + 0.5, 0.0, 1.0), np.float32)


def _horizon(height: HeightMap, exaggeration: float, turn: float, reach_share: float) -> Float32Array:
    """Return the tangent of the horizon's elevation in a direction, counter-clockwise from the right."""
    rows, columns = height.z_um.shape
    z = np.ascontiguousarray(height.z_um) * np.float32(exaggeration / height.pitch_um)
    steps = [1.0]
    # Steps grow with the distance.
    while steps[-1] < reach_share * np.hypot(rows, columns):
        steps.append(steps[-1] + max(1.0, 0.06 * steps[-1]))
    # Rounded, so that a ray along the rows stays on its row.
    down, right = (np.round(np.multiply(steps, part), 4).astype(np.float32) for part in (-np.sin(turn), np.cos(turn)))
    tangent = np.empty_like(z)
    _trace(z, down, right, np.array(steps, np.float32), tangent)
    return tangent


@njit(cache=True, nogil=True, error_model="numpy")
def _trace(z: Any, down: Any, right: Any, steps: Any, tangent: Any) -> None:
    """Write the largest tangent along a ray; beyond the border nothing hides the sky.

    Heights are interpolated: with the nearest pixel, a slope along a diagonal would be 1.4 times too steep.
    """
    rows, columns = z.shape
    for r in range(rows):
        for c in range(columns):
            steepest = np.float32(-1e6)
            for i in range(steps.size):
                y, x = np.float32(r) + down[i], np.float32(c) + right[i]
                if y < 0 or x < 0 or y > rows - 1 or x > columns - 1:
                    break
                top, left = int(y), int(x)
                low, far = min(top + 1, rows - 1), min(left + 1, columns - 1)
                v, u = y - np.float32(top), x - np.float32(left)
                above = z[top, left] + u * (z[top, far] - z[top, left])
                below = z[low, left] + u * (z[low, far] - z[low, left])
                rise = (above + v * (below - above) - z[r, c]) / steps[i]
                if rise > steepest:
                    steepest = rise
            tangent[r, c] = steepest


# Colormaps of heights; each is readable without colour vision, because lightness alone separates high from low.

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
"""Blue below zero, white at zero, orange above: hues that everyone can distinguish."""


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
