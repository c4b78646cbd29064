"""Slopes where an object keeps a light from the skin beside it, or where the skin has turned away from a light.

The inverse map takes three lights for granted. Over the first height map a ray from each pixel towards each light says
where the light may be hidden; a channel that is darker there than the shading model foretells of the slopes that the
other two show, or that would be dark, counts for nothing, and the other two decide, with the surface of the first
integration as what is known beforehand. Shadows are wide beside a pixel, so that a reduced field is enough; what
changes is added to the slopes of every pixel.

Frames of each light alone show where it does not arrive, whatever heights say: there its channel counts for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.illumination import rows_between_nodes
from device.inverse_map.polynomial_features import field_position
from device.surface.fields import Float32Array, Float64Array, GradientField, MaskArray
from host_sync.calibration.elevation_response import ElevationResponse
from host_sync.calibration.shading_model import ShadingModel, intensity_and_slope_change
from host_sync.integration.zero_level import elevation_over_datum_px
from host_sync.kernels.cell_rows import bordered, cells_above, expand_cells
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.reconstruction.elevation_correction import cell_means

WIDEST_CELLS: Final = 256
"""Cells along the reduced field's columns, at most."""

ROUNDS: Final = 2
"""The second ray is drawn over heights that the first has mended."""

PENUMBRA: Final = 0.3
"""A light may be hidden in part where the tangent of its elevation clears the skin by less."""

MIN_SLOPE: Final = 0.1
"""Height maps whose steepest hundredth is gentler than this hide no light."""

DARKER: Final = (0.03, 0.08)
"""Intensity by which a channel is darker than foretold: from the first its weight falls, at the second it is zero."""

SET: Final = (0.16, 0.08)
"""Foretold intensity below which a light is about to set, and at which it has."""

ARRIVES: Final = (0.03, 0.12)
"""What a light alone shows, over what it shows of untouched skin: up to the first it does not arrive, from the second
it does."""

INTENSITY_SIGMA: Final = 0.02
"""Standard uncertainty of the foretold intensity."""

PRIOR_SIGMA: Final = 0.15
"""Standard uncertainty of the slopes of the first integration where a light is hidden."""

STEPS: Final = 10
FREE_STEPS: Final = 4
"""Gauss-Newton steps, and how many of them leave every channel that may be hidden out of account."""

MAX_STEP: Final = 0.3
SHADOW_WEIGHT: Final = 0.3
"""Weight in integration of slopes that two lights tell."""

NEIGHBOURS: Final = 5.0
"""Standard deviation, in cells, of the neighbourhood whose lit skin tells what the model leaves."""

RELATIVE_SIGMA: Final = 0.33
"""Standard uncertainty of a correction as a share of it: what the twin's heights keep of their error."""

SLOPING: Final = 0.05
"""Slope from which lit skin tells that."""


@dataclass(frozen=True, slots=True, eq=False)
class ShadowCorrection:
    """What slopes gain where a light is hidden, at the middles of cells.

    p, q : float32 arrays of shape (h, w), to be added
    sigma_p, sigma_q : float32 arrays of shape (h, w), with sign, by how much slopes are unsure there all at once
    shadow : float32 array of shape (h, w), 0 where every light arrives, 1 where one does not
    cell : pixels along a cell
    weight : of slopes in shadow in the integration
    """

    p: Float32Array
    q: Float32Array
    sigma_p: Float32Array
    sigma_q: Float32Array
    shadow: Float32Array
    cell: int
    weight: float = SHADOW_WEIGHT

    def apply(self, gradients: GradientField) -> None:
        """Write corrected slopes and weights over those of a gradient field (H, W)."""
        less = np.float32(self.weight - 1.0) * self.shadow
        planes = bordered(np.stack([self.p, self.q, less]))
        parallel_rows(_apply, gradients.p.shape, planes, self.cell, gradients.p, gradients.q, gradients.weight)

    def sigma(self, size: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
        """Standard uncertainties of slopes p and q in shadow, with sign, on a field of `size` (w, h)."""
        p, q = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (self.sigma_p, self.sigma_q))
        return np.asarray(p, np.float32), np.asarray(q, np.float32)


def find_cast_shadow(
    gradients: GradientField,
    image: NormalizedImage,
    model: ShadingModel,
    response: ElevationResponse | None,
    alone: Float32Array | None = None,
) -> ShadowCorrection | None:
    """What the slopes of an image (H, W), read as if every light arrived, gain; None where no light is hidden.

    response : what elevation adds to the light; None where it cannot be told
    alone : what each channel shows under its own light alone, over the same of untouched skin, shape (H, W, 3); None
        where single lights were not taken
    """
    cell = -(-gradients.p.shape[1] // WIDEST_CELLS)
    p, q, known = cell_means(gradients.p, gradients.q, gradients.valid, cell)
    if np.quantile(np.hypot(p, q), 0.99) < MIN_SLOPE:
        return None
    view = _Cells.of(image, model, response, p.shape, cell, alone)
    found_p, found_q = p, q
    for _ in range(ROUNDS):
        found = GradientField(found_p, found_q, known, known.astype(np.float32))
        z_px = elevation_over_datum_px(found, float(cell))
        found_p, found_q, shadow = view.slopes(p, q, known, z_px)
        if not shadow.any():
            return None
    change_p, change_q = found_p - p, found_q - q
    share = np.float32(RELATIVE_SIGMA)
    return ShadowCorrection(change_p, change_q, share * change_p, share * change_q, shadow, cell)


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """A frame at the middles of cells, with what the shading model says there.

    intensity : float64 array of shape (h, w, 3)
    coefficients : of the model, float64 array of shape (h w, 3, terms)
    raised : what a pixel of elevation adds, float64 array of shape (h w, 3, 3)
    leaks : of the model
    cell : pixels along a cell
    arriving : how much each light arrives as seen under it alone, 0 to 1, float64 array of shape (h, w, 3)
    """

    intensity: Float64Array
    coefficients: Float64Array
    raised: Float64Array
    leaks: Float64Array
    cell: int
    arriving: Float64Array

    @classmethod
    def of(
        cls,
        image: NormalizedImage,
        model: ShadingModel,
        response: ElevationResponse | None,
        size: tuple[int, int],
        cell: int,
        alone: Float32Array | None,
    ) -> _Cells:
        """The cells of an image (H, W) of `cell` x `cell` pixels, `size` of them."""
        row, column = (np.arange(count) * cell + 0.5 * (cell - 1) for count in size)
        x, y = (field_position(axis, axis, image.shape)[:, k] for k, axis in enumerate((column, row)))
        place = np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1).reshape(-1, 2)
        raised = np.zeros((len(place), 3, 3))
        if response is not None:
            nodes = np.concatenate([response.brightening[..., None, :], response.slanting], axis=-2)
            flat = nodes.reshape(*nodes.shape[:2], 9)
            between = rows_between_nodes(flat, x.astype(np.float32), y.astype(np.float32))
            raised = np.swapaxes(between.reshape(-1, 3, 3), 1, 2).astype(np.float64)
        arriving = np.ones((*size, 3)) if alone is None else _arriving(_of_cells(alone, size, cell))
        return cls(_of_cells(image.values, size, cell), model.at(place), raised, model.leaks, cell, arriving)

    def slopes(
        self, p: Float32Array, q: Float32Array, known: MaskArray, z_px: Float32Array
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Slopes (h, w) with hidden lights left out of account, and how much of each is of that kind, 0 to 1.

        p, q : as read
        known : where they are
        z_px : elevation by which lights are hidden
        """
        slants = self.coefficients[:, :, :2].reshape(*z_px.shape, 3, 2)
        clear = np.stack([clearance(z_px, self.cell, slants[..., k, :]) for k in range(3)], axis=-1)
        hidden = ((clear < PENUMBRA) | (self.arriving < 1.0)) & known[..., None]
        here = np.flatnonzero(hidden.any(axis=-1))
        found_p, found_q, shadow = p.copy(), q.copy(), np.zeros_like(p)
        if not here.size:
            return found_p, found_q, shadow
        prior = np.stack([np.gradient(z_px, self.cell, axis=axis).ravel()[here] for axis in (1, 0)], axis=-1)
        left = self._left(p, q, known & ~hidden.any(axis=-1), z_px).reshape(-1, 3)[here]
        slope, trust = _two_light_slopes(
            self.intensity.reshape(-1, 3)[here] - left,
            self.coefficients[here],
            self.raised[here] * z_px.ravel()[here, None, None],
            hidden.reshape(-1, 3)[here],
            self.arriving.reshape(-1, 3)[here],
            prior.astype(np.float64),
            self.leaks,
        )
        share = 1.0 - trust
        for values, read, new in ((found_p, p, slope[:, 0]), (found_q, q, slope[:, 1])):
            values.ravel()[here] = (1.0 - share) * read.ravel()[here] + share * new
        shadow.ravel()[here] = share
        return found_p, found_q, shadow

    def _left(self, p: Float32Array, q: Float32Array, lit: MaskArray, z_px: Float32Array) -> Float64Array:
        """What the model leaves of the intensity of lit, sloping skin nearby: shape (h, w, 3)."""
        shown = np.flatnonzero(lit & (np.hypot(p, q) > SLOPING))
        seen = np.zeros((*p.shape, 4), np.float32)
        if shown.size:
            raised = self.raised[shown] * z_px.ravel()[shown, None, None]
            there_p, there_q = (values.ravel()[shown].astype(np.float64) for values in (p, q))
            foretold, _ = intensity_and_slope_change(self.coefficients[shown], there_p, there_q, raised)
            seen.reshape(-1, 4)[shown, :3] = self.intensity.reshape(-1, 3)[shown] - foretold
            seen.reshape(-1, 4)[shown, 3] = 1.0
        smooth = cv2.GaussianBlur(seen, (0, 0), NEIGHBOURS).astype(np.float64)
        return np.asarray(smooth[..., :3] / (smooth[..., 3:] + 1e-4))


def clearance(z_px: Float32Array, cell: float, slant: Float64Array) -> Float32Array:
    """By how much the ray to a light clears the skin, as a tangent: least over the way, float32 array (h, w).

    z_px : elevation at cells `cell` pixels apart
    slant : of the light, (h, w, 2): away from it, as long as its zenith angle's tangent
    """
    rows, columns = z_px.shape
    length = np.maximum(np.linalg.norm(slant, axis=-1), 1e-3)
    rise = (1.0 / length).astype(np.float32)
    across, down = ((-slant[..., k] / length).astype(np.float32) for k in (0, 1))
    column, row = np.meshgrid(np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32))
    clear = np.full_like(z_px, np.inf)
    height_px = float(z_px.max()) - float(np.quantile(z_px, 0.01))
    reach = min(int(height_px / float(rise.min()) / cell) + 2, max(rows, columns))
    for step in range(1, reach):
        met = cv2.remap(
            z_px, column + step * across, row + step * down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        np.minimum(clear, rise - (met - z_px) / np.float32(step * cell), out=clear)
    return clear


def _two_light_slopes(
    intensity: Float64Array,
    coefficients: Float64Array,
    raised: Float64Array,
    hidden: MaskArray,
    arriving: Float64Array,
    prior: Float64Array,
    leaks: Float64Array,
) -> tuple[Float64Array, Float64Array]:
    """Slopes (N, 2) that the lights tell which reach the skin, and the weight (N,) of the least of the others.

    intensity : shape (N, 3)
    coefficients, raised : as of `intensity_and_slope_change`
    hidden : shape (N, 3), lights that may be hidden
    arriving : shape (N, 3), the most that they may count
    prior : slopes known beforehand, shape (N, 2)
    leaks : of the shading model
    """
    slope, trust = prior.copy(), np.where(hidden, 0.0, 1.0)
    for step in range(STEPS):
        foretold, change = intensity_and_slope_change(coefficients, slope[:, 0], slope[:, 1], raised)
        if step >= FREE_STEPS:
            trust = np.where(hidden, np.minimum(arriving, _trust(intensity, foretold)), 1.0)
        weight = trust / INTENSITY_SIGMA**2
        # A hidden light is missing from the other channels too, as far as their filters pass it.
        lost = (1.0 - trust) * np.maximum(foretold - intensity, 0.0)
        foretold = foretold - leaks * (lost.sum(axis=1, keepdims=True) - lost)
        move = _least_squares(change, weight, intensity - foretold, prior - slope)
        length = np.linalg.norm(move, axis=1, keepdims=True)
        slope += move * np.minimum(1.0, MAX_STEP / np.maximum(length, 1e-9))
    return slope, trust.min(axis=1)


def _least_squares(
    change: Float64Array, weight: Float64Array, missing: Float64Array, back: Float64Array
) -> Float64Array:
    """Step (N, 2) that explains missing intensity (N, 3) best, with known slopes `back` away."""
    prior = 1.0 / PRIOR_SIGMA**2
    by_p, by_q = change[..., 0], change[..., 1]
    pp, pq, qq = (
        np.einsum("nc,nc->n", weight * one, other) for one, other in ((by_p, by_p), (by_p, by_q), (by_q, by_q))
    )
    along_p, along_q = (np.einsum("nc,nc->n", weight * missing, one) for one in (by_p, by_q))
    along_p, along_q = along_p + prior * back[:, 0], along_q + prior * back[:, 1]
    pp, qq = pp + prior, qq + prior
    move = np.stack([qq * along_p - pq * along_q, pp * along_q - pq * along_p], axis=-1)
    return np.asarray(move / (pp * qq - pq * pq)[:, None])


def _trust(intensity: Float64Array, foretold: Float64Array) -> Float64Array:
    """Weight of channels (N, 3) that may be dark: 0 where darker than foretold, or where no light is foretold."""
    missing = np.clip((foretold - intensity - DARKER[0]) / (DARKER[1] - DARKER[0]), 0.0, 1.0)
    setting = np.clip((SET[0] - foretold) / (SET[0] - SET[1]), 0.0, 1.0)
    return np.asarray(((1.0 - missing) * (1.0 - setting)) ** 2)


def _arriving(alone: Float64Array) -> Float64Array:
    """Weight of lights of which so much is seen alone."""
    return np.asarray(np.clip((alone - ARRIVES[0]) / (ARRIVES[1] - ARRIVES[0]), 0.0, 1.0) ** 2)


def _of_cells(values: Float32Array, size: tuple[int, int], cell: int) -> Float64Array:
    """Means over cells of values (H, W, 3), float64 array of shape (h, w, 3)."""
    below, right = (count * cell - have for count, have in zip(size, values.shape[:2], strict=True))
    channels = []
    for channel in range(3):
        plane = np.ascontiguousarray(values[..., channel])
        whole = cv2.copyMakeBorder(plane, 0, below, 0, right, cv2.BORDER_REPLICATE)
        channels.append(cv2.resize(whole, size[::-1], interpolation=cv2.INTER_AREA))
    return np.stack(channels, axis=-1).astype(np.float64)


@njit(cache=True, nogil=True)
def _apply(planes: Any, cell: int, p: Any, q: Any, weight: Any, first: int, last: int) -> None:
    """Add the first two planes of cells to slopes, and the third's share of the weight to it, in rows."""
    upper, step = np.empty((len(planes), p.shape[1]), np.float32), np.empty((len(planes), p.shape[1]), np.float32)
    expanded = -1
    for r in range(first, last):
        top, share = cells_above(r, cell, planes.shape[1])
        if top != expanded:
            expand_cells(planes, top, cell, 0, upper, step)
            expanded = top
        for c in range(p.shape[1]):
            p[r, c] += upper[0, c] + share * step[0, c]
            q[r, c] += upper[1, c] + share * step[1, c]
            weight[r, c] += weight[r, c] * (upper[2, c] + share * step[2, c])
