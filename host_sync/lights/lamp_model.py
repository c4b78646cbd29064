"""What skin of any slope shows at any place and elevation under near lamps: physics with few numbers.

Each channel has a lamp of its own over the skin: a point or a strip, whose light falls off with a power of its
distance. A rough coat reflects it (Oren and Nayar, "Generalization of Lambert's reflectance model", SIGGRAPH 1994), and
shines (microfacets as of Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007, with a
tail that may be shorter or longer, as of Burley, "Physically based shading at Disney", SIGGRAPH 2012). Filters pass
some of the other lamps' light, haze lights all skin alike, and slanted skin receives light from skin beside it
(`surroundings`). As intensity is divided by that of untouched skin, neither vignetting nor the lamps' brightness
matters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float64Array
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.lights.lamp_kernel import write_light

POINTS: Final = (-0.387, 0.0, 0.387)
POINT_SHARES: Final = (5 / 18, 8 / 18, 5 / 18)
"""Gauss-Legendre points and weights along a strip of length 1."""

WORK: Final = 64
"""Pixels of a field whose kernels take as long as the light of one place."""


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
    gloss : how strongly shining facets count; diffuse skin counts as 1 - gloss
    gloss_width : width of that reflection, the microfacets' alpha
    tilt_gain : by what share skin of tilt t shows more than such a coat does, over 1 - cos t: flakes show less
    bounce_close, bounce_afar : light that skin of tilt t receives from skin close by (`surroundings`) and from level
        skin farther away, over 1 - cos t times what that skin shows
    beam : share of a lamp's light that goes with the cosine from its axis; the rest shines alike in all directions
    aim : tangent of those axes' elevation over that of the lamp from the middle of the field; 1 where they meet there
    tail : power with which that reflection fades away from its middle: 2 of most coats, far more of aligned flakes
    camera : one over the camera's height over the middle of the field; 0 where it sees all skin from straight above
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
    tilt_gain: float
    bounce_close: float
    bounce_afar: float
    beam: float
    tail: float
    camera: float
    aim: float = 1.0

    def shown(
        self,
        p: Float64Array,
        q: Float64Array,
        column: Float64Array,
        row: Float64Array,
        z_px: Float64Array,
        close: Float64Array | None = None,
    ) -> Float64Array:
        """Intensity, divided by that of untouched skin at the same place: float64 array of shape (N, 3).

        p, q : slopes, shape (N,)
        column, row : pixels, shape (N,)
        z_px : elevation over untouched skin, shape (N,)
        close : what skin close to each place shows, shape (N, 3); None where it is untouched
        """
        level = np.zeros_like(column)
        direct = self._light(p, q, column, row, z_px) / self._light(level, level, column, row, level)
        return np.asarray(direct + self.bounced(p, q, np.ones_like(direct) if close is None else close))

    def bounced(self, p: Float64Array, q: Float64Array, close: Float64Array) -> Float64Array:
        """Intensity (N, 3) that slopes (N,) receive from skin around them, of which that close by shows `close`; of
        slopes (K, N) it is of shape (K, N, 3).
        """
        tilted = 1.0 - 1.0 / np.sqrt(1.0 + p * p + q * q)
        return np.asarray(tilted[..., None] * (self.bounce_afar + self.bounce_close * close))

    def own_light(
        self,
        p: Float64Array,
        q: Float64Array,
        column: Float64Array,
        row: Float64Array,
        z_px: Float64Array,
        visible: Float64Array | None = None,
    ) -> Float64Array:
        """What skin shows of each channel's own lamp directly, up to a factor of its own: shape (N, 3).

        For K slopes at each place, p and q of shape (N, K), it is of shape (N, K, 3).

        visible : share of the light of each of a lamp's points that arrives, float64 array of shape (N, 3, points);
            None where all of it does
        """
        count = 1 if p.ndim == 1 else p.shape[1]
        slopes = (np.ascontiguousarray(part.reshape(len(column), count)) for part in (p, q))
        own = np.empty((len(column), count, 3))
        points, axes, coat = self.lamps_and_coat()
        skin = (*slopes, *self.places(column, row, z_px))
        parallel_rows(write_light, (len(own), WORK), points, arriving_or_all(visible), axes, coat, *skin, own)
        return own.reshape(*p.shape, 3)

    def places(self, column: Float64Array, row: Float64Array, z_px: Float64Array) -> tuple[Float64Array, ...]:
        """Places x, y and z of skin, shape (N,), in widths of the field from its middle."""
        rows, columns = self.shape
        return (column - 0.5 * (columns - 1)) / columns, (row - 0.5 * (rows - 1)) / columns, z_px / columns

    def lamps_and_coat(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Points, axes and coat as `write_light` takes them."""
        axes = self.position * np.array([1.0, 1.0, self.aim])
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        square = self.roughness**2
        even, uneven = 1.0 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
        shine = (self.gloss, self.gloss_width**2, self.tail)
        coat = np.array([self.fall_off, even, uneven, *shine, self.tilt_gain, self.beam, self.camera])
        return self.points(), axes, coat

    def mixed(self, own: Float64Array) -> Float64Array:
        """What the channels show of their own and the others' lamps: float64 array of shape (N, 3)."""
        return np.asarray(own @ self.mixing.T + self.haze)

    def _light(self, *skin: Float64Array) -> Float64Array:
        """Intensity up to a factor of place and channel, of skin as in `shown`."""
        return self.mixed(self.own_light(*skin))

    def points(self) -> Float64Array:
        """Where the points of each lamp are, in widths of the field, and how bright: float64 array (3, points, 4)."""
        right, down, above = self.position.T
        reach = np.maximum(np.hypot(right, down), 1e-6)
        along = self.strip * np.stack([-down / reach, right / reach, np.zeros(3)], axis=-1)
        places = self.position[:, None] + np.array(POINTS)[:, None] * along[:, None]
        bright = np.array(POINT_SHARES) * above[:, None] ** self.fall_off
        return np.concatenate([places, bright[..., None]], axis=-1)


def arriving_or_all(visible: Float64Array | None) -> Float64Array:
    """What arrives of lamps' points as `write_light` takes it: shape (N, 3, points), (0, 3, points) where all does."""
    return np.empty((0, 3, len(POINTS))) if visible is None else visible


@dataclass(frozen=True, slots=True, eq=False)
class FittedLamps:
    """Lamps that balls tell.

    model : of all balls
    folds : as they would be without every K-th ball, from each of the first K on
    """

    model: LampModel
    folds: tuple[LampModel, ...]

    def without(self, ball: int) -> LampModel:
        """The lamps that balls show without the fold of the ball of this number; without folds those of all balls."""
        return self.folds[ball % len(self.folds)] if self.folds else self.model
