"""Skin that a known lamp does not reach, where no shading model says what the other two lights tell.

Coats that glitter have no model of single channels that could be trusted. But where the lamps stand is known, and the
first height map says which skin each of them reaches. Slopes of skin that lies in shadow or has turned away from a lamp
are read up to twice too steep: they count for little in the integration, and the lit sides of an object decide.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from device.surface.fields import Float32Array, Float64Array, GradientField, MaskArray
from host_sync.integration.datum import skin_at_rest, zero_to_datum
from host_sync.integration.integrate import Integrator
from host_sync.kernels.cell_rows import cell_px
from host_sync.lights.known_lamps import KnownLamps
from host_sync.reconstruction.cast_shadow import MIN_SLOPE
from host_sync.reconstruction.cell_correction import CellCorrection
from host_sync.reconstruction.elevation_correction import cell_means
from host_sync.reconstruction.hidden_lights import clearance

ROUNDS: Final = 3
"""The first heights are too large, and so are their shadows."""

PENUMBRA: Final = 0.02
"""A lamp is hidden in part where the tangent of its elevation clears the skin by less."""

SET: Final = 0.1
"""Light on skin, as a share of that on level skin, below which a lamp has set."""

HIDDEN_WEIGHT: Final = 0.05
"""Weight of hidden slopes in integration."""

RELATIVE_SIGMA: Final = 0.02
"""Standard uncertainty of slopes that integration finds there, as a share of those that were read."""


def find_hidden_skin(gradients: GradientField, lamps: KnownLamps) -> CellCorrection | None:
    """Where slopes (H, W) count for little because a lamp does not reach them; None where all lamps do."""
    shape = (gradients.p.shape[0], gradients.p.shape[1])
    cell = cell_px(shape)
    p, q, known = cell_means(gradients.p, gradients.q, gradients.valid, cell)
    if np.quantile(np.hypot(p, q), 0.99) < MIN_SLOPE:
        return None
    field = GradientField(p, q, known, known.astype(np.float32))
    at_rest = skin_at_rest(field)
    solver = Integrator(p.shape)
    hidden = np.zeros(p.shape, np.bool_)
    z_px = np.zeros_like(p)
    for _ in range(ROUNDS):
        weight = np.where(hidden, np.float32(HIDDEN_WEIGHT), np.float32(1.0)) * known
        height, _ = solver.integrate(replace(field, weight=weight.astype(np.float32)), float(cell))
        if at_rest is not None:
            height = zero_to_datum(height, at_rest)
        z_px = np.where(np.isfinite(height.z_um), height.z_um, np.float32(0.0))
        hidden = _hidden(z_px, field, lamps.slants(z_px, cell, shape), cell)
        if not hidden.any():
            return None
    shadow = hidden.astype(np.float32)
    share = np.float32(RELATIVE_SIGMA) * shadow
    nothing = np.zeros_like(p)
    return CellCorrection(nothing, nothing, share * p, share * q, shadow, cell, HIDDEN_WEIGHT)


def _hidden(z_px: Float32Array, field: GradientField, slants: Float64Array, cell: int) -> MaskArray:
    """Where a lamp is hidden or has set: bool array of shape (h, w)."""
    hidden = np.zeros(z_px.shape, np.bool_)
    for lamp in range(slants.shape[2]):
        slant = slants[..., lamp, :]
        facing = 1.0 + slant[..., 0] * field.p + slant[..., 1] * field.q
        hidden |= (clearance(z_px, cell, slant) < PENUMBRA) | (facing < SET)
    return np.asarray(hidden & field.valid)
