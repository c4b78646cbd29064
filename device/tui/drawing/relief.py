"""A height map as terminal cells: lit from the upper left, coloured by height where the terminal has colours.

Colours go from deep blue over green to sand with increasing brightness, so that they also read without colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array, HeightMap, MaskArray
from device.tui.drawing.cells import CellGrid, ColourDepth
from device.tui.drawing.half_blocks import colour_cells, grey_cells
from device.tui.drawing.resampling import resampled

MIN_SPAN_UM: Final = 4.0
"""Flatter maps are drawn with this range, so that noise does not look like relief."""

_LIGHT: Final = (-0.5, -0.5, 0.70711)
_SHOWN_SLOPE: Final = 0.6
_MAX_GAIN: Final = 12.0
_HEIGHT_PART: Final[dict[ColourDepth, float]] = {"sixteen": 0.6, "mono": 2.0}
"""Weight of height against light where there are no colours."""


_ANCHORS: Final = np.array(
    [(26, 34, 74), (36, 82, 120), (48, 132, 134), (112, 174, 124), (206, 198, 128), (252, 238, 208)], np.float32
)


@dataclass(frozen=True, slots=True)
class HeightRange:
    """Heights (µm) at the ends of the scale; 99 % of a map lie between them."""

    lowest_um: float
    highest_um: float

    @classmethod
    def of(cls, z_um: Float32Array) -> HeightRange:
        """The range of a map or profile; `MIN_SPAN_UM` around zero without a valid pixel."""
        z_um = z_um[np.isfinite(z_um)]
        low, high = np.percentile(z_um, (0.5, 99.5)) if z_um.size else (0.0, 0.0)
        lacking = max(MIN_SPAN_UM - (high - low), 0.0) / 2.0
        return cls(float(low) - lacking, float(high) + lacking)

    def fraction(self, z_um: Float32Array) -> Float32Array:
        """Heights as fractions of the range, 0 to 1."""
        span = self.highest_um - self.lowest_um
        return np.asarray(np.clip((z_um - self.lowest_um) / span, 0.0, 1.0), np.float32)


def relief_cells(height: HeightMap, heights: HeightRange, shape: tuple[int, int], depth: ColourDepth) -> CellGrid:
    """Cells of a map, `shape` (rows, columns) of them; invalid ones are hatched."""
    z_um = resampled(height.z_um, (2 * shape[0], shape[1]))
    valid = np.isfinite(z_um)
    pitch_um = height.pitch_um * height.z_um.shape[1] / shape[1]
    light = lit(z_um, pitch_um)
    fraction = heights.fraction(z_um)
    if depth == "full":
        return colour_cells(height_colours(fraction, 0.35 + 0.9 * light), valid)
    return grey_cells(_stretched(_HEIGHT_PART[depth] * fraction + light, valid), valid, depth)


def _stretched(brightness: Float32Array, valid: MaskArray) -> Float32Array:
    """Brightness stretched from 0 to 1 over 96 % of the valid pixels, to use all of the few greys."""
    low, high = np.percentile(brightness[valid], (2, 98)) if valid.any() else (0.0, 1.0)
    return np.asarray((brightness - low) / max(high - low, 0.1), np.float32)


def lit(z_um: Float32Array, pitch_um: float) -> Float32Array:
    """Diffuse light from the upper left, 0 to 1, 0.71 where flat; slopes are exaggerated to be visible."""
    q, p = np.gradient(z_um / np.float32(pitch_um)) if min(z_um.shape) > 1 else (z_um * 0.0, z_um * 0.0)
    p, q = np.nan_to_num(p), np.nan_to_num(q)
    steep = float(np.percentile(np.hypot(p, q), 95))
    gain = min(_SHOWN_SLOPE / max(steep, 1e-6), _MAX_GAIN)
    p, q = gain * p, gain * q
    cosine = (-p * _LIGHT[0] - q * _LIGHT[1] + _LIGHT[2]) / np.sqrt(1.0 + p * p + q * q)
    return np.asarray(np.clip(cosine, 0.0, 1.0), np.float32)


def height_colours(fraction: Float32Array, shade: Float32Array) -> NDArray[np.int32]:
    """Colours as 0xRRGGBB.

    Parameters
    ----------
    fraction : float32 array, height from 0 (lowest) to 1 (highest); NaN counts as 0
    shade : float32 array of the same shape, factor on the colour's brightness
    """
    place = np.clip(np.nan_to_num(fraction), 0.0, 1.0) * (len(_ANCHORS) - 1)
    below = np.minimum(place.astype(np.int32), len(_ANCHORS) - 2)
    within = (place - below)[..., np.newaxis]
    colour = (_ANCHORS[below] * (1.0 - within) + _ANCHORS[below + 1] * within) * shade[..., np.newaxis]
    red, green, blue = np.moveaxis(np.clip(colour + 0.5, 0.0, 255.0).astype(np.int32), -1, 0)
    return np.asarray((red << 16) | (green << 8) | blue, np.int32)
