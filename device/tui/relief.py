"""A height map as terminal cells: shaded from the upper left, coloured by height where there are colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface import Float32Array, HeightMap, MaskArray
from device.tui.cells import Cells
from device.tui.colour_map import height_colours
from device.tui.half_blocks import colour_cells, grey_cells
from device.tui.resampling import resampled
from device.tui.terminal import ColourDepth

LEAST_SPAN_UM: Final = 4.0
"""Flatter maps are drawn as if they spanned this much, so that noise does not look like relief."""

_LIGHT: Final = (-0.5, -0.5, 0.70711)
_SHOWN_SLOPE: Final = 0.6
_MOST_GAIN: Final = 12.0
_HEIGHT_PART: Final[dict[ColourDepth, float]] = {"sixteen": 0.6, "mono": 2.0}
"""What height adds to the light where there are no colours for it."""


@dataclass(frozen=True, slots=True)
class HeightRange:
    """The heights (µm) at the ends of the scale; 99 % of a map lie between."""

    lowest_um: float
    highest_um: float

    @classmethod
    def of(cls, z_um: Float32Array) -> HeightRange:
        """The range of a map or profile; of one without a valid pixel, the least range around zero."""
        z_um = z_um[np.isfinite(z_um)]
        low, high = np.percentile(z_um, (0.5, 99.5)) if z_um.size else (0.0, 0.0)
        lacking = max(LEAST_SPAN_UM - (high - low), 0.0) / 2.0
        return cls(float(low) - lacking, float(high) + lacking)

    def share(self, z_um: Float32Array) -> Float32Array:
        """Where heights lie in the range, 0 to 1."""
        span = self.highest_um - self.lowest_um
        return np.asarray(np.clip((z_um - self.lowest_um) / span, 0.0, 1.0), np.float32)


def relief_cells(height: HeightMap, heights: HeightRange, shape: tuple[int, int], depth: ColourDepth) -> Cells:
    """Cells of a map, `shape` (rows, columns) of them; what is invalid is hatched."""
    z_um = resampled(height.z_um, (2 * shape[0], shape[1]))
    valid = np.isfinite(z_um)
    pitch_um = height.pitch_um * height.z_um.shape[1] / shape[1]
    light = lit(z_um, pitch_um)
    share = heights.share(z_um)
    if depth == "full":
        return colour_cells(height_colours(share, 0.35 + 0.9 * light), valid)
    return grey_cells(_stretched(_HEIGHT_PART[depth] * share + light, valid), valid, depth)


def _stretched(brightness: Float32Array, valid: MaskArray) -> Float32Array:
    """The same from 0 to 1 over nearly all valid pixels: few greys are there, and all are used."""
    low, high = np.percentile(brightness[valid], (2, 98)) if valid.any() else (0.0, 1.0)
    return np.asarray((brightness - low) / max(high - low, 0.1), np.float32)


def lit(z_um: Float32Array, pitch_um: float) -> Float32Array:
    """Diffuse light from the upper left, 0 to 1, 0.71 where flat; slopes are exaggerated until most of them show."""
    q, p = np.gradient(z_um / np.float32(pitch_um)) if min(z_um.shape) > 1 else (z_um * 0.0, z_um * 0.0)
    p, q = np.nan_to_num(p), np.nan_to_num(q)
    steep = float(np.percentile(np.hypot(p, q), 95))
    gain = min(_SHOWN_SLOPE / max(steep, 1e-6), _MOST_GAIN)
    p, q = gain * p, gain * q
    cosine = (-p * _LIGHT[0] - q * _LIGHT[1] + _LIGHT[2]) / np.sqrt(1.0 + p * p + q * q)
    return np.asarray(np.clip(cosine, 0.0, 1.0), np.float32)
