"""What skin of any slope shows at any place and elevation under near lamps: physics with few numbers.

Each channel has a lamp of its own over the skin: a point or a strip, whose light falls off with a power of its
distance. A rough coat reflects it (Oren and Nayar, "Generalization of Lambert's reflectance model", SIGGRAPH 1994), and
shines (microfacets as of Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007). Filters
pass some of the other lamps' light, haze lights all skin alike, and slanted skin receives light from skin beside it.
As intensity is divided by that of untouched skin, neither vignetting nor the lamps' brightness matters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float64Array

POINTS: Final = (-0.387, 0.0, 0.387)
POINT_SHARES: Final = (5 / 18, 8 / 18, 5 / 18)
"""Gauss-Legendre points and weights along a strip of length 1."""

GRAZING: Final = 0.05
"""Cosine below which reflection is not followed further: the models of rough skin end before."""


@dataclass(frozen=True, slots=True, eq=False)
class LampModel:
    """Lamps and coat of an instrument; lengths in widths of the field.

    shape : (H, W) of the full-size field, pixels
    position : float64 array of shape (3, 3), by channel right, down and up from the middle of untouched skin
    strip : length of each lamp, across the direction to the middle
    fall_off : power of the distance with which light falls off; 2 for lamps that shine alike in all directions
    mixing : float64 array of shape (3, 3), by channel what it passes of each lamp's light; 1 of its own
    haze : float64 array of shape (3,), light that does not depend on the slope
    roughness : of the coat, the standard deviation of its facets' slopes, radians
    gloss : share of the coat that shines
    gloss_width : width of that reflection, the microfacets' alpha
    bounce : what slanted skin receives from skin beside it, as a share of its own light
    beam : share of a lamp's light that goes with the cosine from its axis, which meets the middle of the field; the
        rest shines alike in all directions
    """

    shape: tuple[int, int]
    position: Float64Array
    strip: float
    fall_off: float
    mixing: Float64Array
    haze: Float64Array
    roughness: float
    gloss: float
    gloss_width: float
    bounce: float
    beam: float

    def shown(
        self, p: Float64Array, q: Float64Array, column: Float64Array, row: Float64Array, z_px: Float64Array
    ) -> Float64Array:
        """Intensity, divided by that of untouched skin at the same place: float64 array of shape (N, 3).

        p, q : slopes, shape (N,)
        column, row : pixels, shape (N,)
        z_px : elevation over untouched skin, shape (N,)
        """
        level = np.zeros_like(column)
        return np.asarray(self._light(p, q, column, row, z_px) / self._light(level, level, column, row, level))

    def _light(
        self, p: Float64Array, q: Float64Array, column: Float64Array, row: Float64Array, z_px: Float64Array
    ) -> Float64Array:
        """Intensity up to a factor of place and channel: float64 array of shape (N, 3)."""
        rows, columns = self.shape
        x, y = (column - 0.5 * (columns - 1)) / columns, (row - 0.5 * (rows - 1)) / columns
        up = 1.0 / np.sqrt(1.0 + p * p + q * q)
        normal = np.stack([-p * up, -q * up, up])
        own = np.empty((3, len(x)))
        for channel, (right, down, above) in enumerate(self.position):
            reach = max(float(np.hypot(right, down)), 1e-6)
            along = self.strip * np.array([-down, right]) / reach
            axis = np.array([right, down, above]) / np.sqrt(right**2 + down**2 + above**2)
            total = np.zeros_like(x)
            for point, share in zip(POINTS, POINT_SHARES, strict=True):
                light = np.stack([right + point * along[0] - x, down + point * along[1] - y, above - z_px / columns])
                distance = np.sqrt((light**2).sum(axis=0))
                light /= distance
                lit = (1.0 - self.beam) + self.beam * np.maximum(axis @ light, 0.0)
                total += share * lit * self._reflected(normal, light) * distance**-self.fall_off
            own[channel] = total * above**self.fall_off
        own *= 1.0 + self.bounce * (1.0 - up)
        return np.asarray(own.T @ self.mixing.T + self.haze)

    def _reflected(self, normal: Float64Array, light: Float64Array) -> Float64Array:
        """Towards the camera straight above, of directions (3, N) of the skin and to a lamp: shape (N,)."""
        seen = normal[2]
        lit = np.maximum((normal * light).sum(axis=0), 0.0)
        square = self.roughness**2
        even, uneven = 1.0 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
        together = np.maximum(light[2] - lit * seen, 0.0) / np.maximum(np.maximum(lit, seen), GRAZING)
        matt = lit * (even + uneven * together)
        if self.gloss == 0.0:
            return np.asarray(matt)
        half = (lit + seen) / np.sqrt(2.0 + 2.0 * light[2])
        narrow = self.gloss_width**2
        facets = narrow / (np.pi * (half * half * (narrow - 1.0) + 1.0) ** 2)
        unmasked = _unmasked(lit, narrow) * _unmasked(seen, narrow)
        return np.asarray((1.0 - self.gloss) * matt + self.gloss * facets * unmasked / np.maximum(4.0 * seen, GRAZING))


def _unmasked(cosine: Float64Array, narrow: float) -> Float64Array:
    """Share of microfacets that others do not hide (Smith's)."""
    return np.asarray(2.0 * cosine / (cosine + np.sqrt(narrow + (1.0 - narrow) * cosine * cosine) + 1e-9))
