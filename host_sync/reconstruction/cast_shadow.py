"""Slopes where an object keeps a light from the skin beside it, or where the skin has turned away from a light.

The inverse map takes three lights for granted. Over the first height map a ray from each pixel towards each light says
where the light may be hidden; a channel that is darker there than the shading model predicts of the slopes that the
other two show, or that would be dark, counts for nothing, and the other two decide, with the surface of the first
integration as what is known beforehand. Shadows are wide beside a pixel, so that a reduced field is enough; what
changes is added to the slopes of every pixel.

Frames of each light alone show where it does not arrive, whatever heights say: there its channel counts for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.illumination import rows_between_nodes
from device.inverse_map.polynomial_features import field_position
from device.surface.fields import Float32Array, Float64Array, GradientField, MaskArray
from host_sync.calibration.elevation_response import ElevationResponse
from host_sync.calibration.shading_model import ShadingModel, intensity_and_slope_change
from host_sync.integration.zero_level import elevation_over_datum_px
from host_sync.kernels.cell_rows import cell_px, means_of_cells, middles_of_cells
from host_sync.lights.lamp_slopes import bounded, gauss_newton_step
from host_sync.reconstruction.cell_correction import CellCorrection
from host_sync.reconstruction.elevation_correction import cell_means
from host_sync.reconstruction.hidden_lights import arriving_share, clearance, trust_in

ROUNDS: Final = 2
"""The second ray is drawn over heights that the first has mended."""

PENUMBRA: Final = 0.3
"""A light may be hidden in part where the tangent of its elevation clears the skin by less."""

MIN_SLOPE: Final = 0.1
"""Height maps whose steepest hundredth is gentler than this hide no light."""

DARKER: Final = (0.03, 0.08)
"""Intensity by which a channel is darker than predicted: from the first its weight falls, at the second it is zero."""

INTENSITY_SIGMA: Final = 0.02
"""Standard uncertainty of the predicted intensity."""

PRIOR_SIGMA: Final = 0.15
"""Standard uncertainty of the slopes of the first integration where a light is hidden."""

STEPS: Final = 10
FREE_STEPS: Final = 4
"""Gauss-Newton steps, and how many of them leave every channel that may be hidden out of account."""

SHADOW_WEIGHT: Final = 0.3
"""Weight in integration of slopes that two lights tell."""

NEIGHBOURS: Final = 5.0
"""Standard deviation, in cells, of the neighbourhood whose lit skin tells what the model leaves."""

RELATIVE_SIGMA: Final = 0.33
"""Standard uncertainty of a correction as a share of it: what the twin's heights keep of their error."""

SLOPING: Final = 0.05
"""Slope from which lit skin tells that."""


def find_cast_shadow(
    gradients: GradientField,
    image: NormalizedImage,
    model: ShadingModel,
    response: ElevationResponse | None,
    alone: Float32Array | None = None,
) -> CellCorrection | None:
    """What the slopes of an image (H, W), read as if every light arrived, gain; None where no light is hidden.

    response : what elevation adds to the light; None where it cannot be told
    alone : what each channel shows under its own light alone, over the same of untouched skin, shape (H, W, 3); None
        where single lights were not taken
    """
    cell = cell_px(gradients.p.shape)
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
    return CellCorrection(change_p, change_q, share * change_p, share * change_q, shadow, cell, SHADOW_WEIGHT)


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
        row, column = middles_of_cells(size, cell)
        x, y = (field_position(axis, axis, image.shape)[:, k] for k, axis in enumerate((column, row)))
        place = np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1).reshape(-1, 2)
        raised = np.zeros((len(place), 3, 3))
        if response is not None:
            nodes = np.concatenate([response.brightening[..., None, :], response.slanting], axis=-2)
            flat = nodes.reshape(*nodes.shape[:2], 9)
            between = rows_between_nodes(flat, x.astype(np.float32), y.astype(np.float32))
            raised = np.swapaxes(between.reshape(-1, 3, 3), 1, 2).astype(np.float64)
        arriving = np.ones((*size, 3)) if alone is None else arriving_share(means_of_cells(alone, size, cell))
        return cls(means_of_cells(image.values, size, cell), model.at(place), raised, model.leaks, cell, arriving)

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
            predicted, _ = intensity_and_slope_change(self.coefficients[shown], there_p, there_q, raised)
            seen.reshape(-1, 4)[shown, :3] = self.intensity.reshape(-1, 3)[shown] - predicted
            seen.reshape(-1, 4)[shown, 3] = 1.0
        smooth = cv2.GaussianBlur(seen, (0, 0), NEIGHBOURS).astype(np.float64)
        return np.asarray(smooth[..., :3] / (smooth[..., 3:] + 1e-4))


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
        predicted, change = intensity_and_slope_change(coefficients, slope[:, 0], slope[:, 1], raised)
        if step >= FREE_STEPS:
            trust = np.where(hidden, np.minimum(arriving, trust_in(intensity, predicted, DARKER)), 1.0)
        weight = trust / INTENSITY_SIGMA**2
        # A hidden light is missing from the other channels too, as far as their filters pass it.
        lost = (1.0 - trust) * np.maximum(predicted - intensity, 0.0)
        predicted = predicted - leaks * (lost.sum(axis=1, keepdims=True) - lost)
        move = gauss_newton_step(change, weight, intensity - predicted, prior - slope, PRIOR_SIGMA)
        slope += bounded(move)
    return slope, trust.min(axis=1)
