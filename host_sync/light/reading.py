"""Slopes of a frame by the light model: what the inverse map's slopes gain over cells."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.skin_at_rest import RestEvidence
from device.surface.fields import Float32Array, Float64Array, GradientField
from host_sync.integration.datum import cell_means
from host_sync.kernels.cell_rows import WHOLE_CELL, WIDEST_CELLS, means_of_cells, middles_of_cells
from host_sync.light.bent_cells import slopes_hidden_by_means
from host_sync.light.cell_correction import CellCorrection, SlopePair
from host_sync.light.cells import SHADOW_WEIGHT, Cells, CellSlopes
from host_sync.light.fit import FittedLight
from host_sync.light.model import LightModel
from host_sync.light.raised_field import RaisedField, intensity_changes, solve_raised
from host_sync.uncertainty.calibration_uncertainty import jackknifed
from host_sync.uncertainty.elevation import ElevationCorrection

SHADOW_SIGMA: Final = 0.12
"""Standard uncertainty of what slopes gain in shadow, as a fraction of it, wrong all at once."""

ARRIVES: Final = (0.03, 0.12)
"""Intensity under a single light over that of skin at rest: up to the first it is hidden, from the second it is not."""

LEVEL: Final = 0.005
"""Slope up to which the calibration's uncertainty is negligible."""


def correct_slopes(
    gradients: GradientField,
    image: NormalizedImage,
    light: FittedLight,
    prior_sigma: float,
    elevation: ElevationCorrection,
    alone: Float32Array | None = None,
    rest: RestEvidence | None = None,
    cells_across: int = WIDEST_CELLS,
) -> CellCorrection:
    """Return what slopes (H, W) by the inverse map gain.

    prior_sigma : standard uncertainty of these slopes, on held-out balls
    elevation : at which balls showed slopes, and what another elevation changes
    alone : intensity of each channel under its own light alone, shape (H, W, C); None where single lights were not
        taken
    rest : where light shows skin at rest; None without a reference
    cells_across : cells along the columns, at most
    """
    cell = -(-gradients.p.shape[1] // cells_across)
    p, q, known = cell_means(gradients.p, gradients.q, gradients.valid, cell)
    size = p.shape[0], p.shape[1]
    bend, spread = (part.reshape(-1, part.shape[-1]) for part in slopes_hidden_by_means(gradients, size, cell))
    intensity = means_of_cells(image.values, size, cell).reshape(bend.shape[0], -1)
    whole = means_of_cells(image.faithful.astype(np.float32)[..., None], size, cell).ravel()
    faithful = (whole > WHOLE_CELL) & known.ravel() & np.isfinite(intensity).all(axis=1)
    start = np.stack([p, q], axis=-1).astype(np.float64).reshape(-1, 2) - bend
    arriving = None
    if alone is not None:
        shown = means_of_cells(alone, size, cell).reshape(bend.shape[0], -1)
        arriving = np.clip((shown - ARRIVES[0]) / (ARRIVES[1] - ARRIVES[0]), 0.0, 1.0)
    columns, rows = np.meshgrid(*middles_of_cells(size, cell)[::-1])
    places = columns.ravel(), rows.ravel()
    uneven = light.model.residual_gain(start, light.model.places(*places, np.zeros(len(start))), spread)
    known_intensity = np.where(faithful[:, None], intensity - uneven, 1.0)
    kept, zero_sigma_px = None, 0.0
    if rest is not None and not rest.has_rest:
        zero_sigma_px = elevation.apex_px
    elif rest is not None:
        kept = np.asarray(cv2.resize(rest.kept, size[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
    believed = light.model.believed_fraction(prior_sigma)
    cells = Cells(
        light.model, size, cell, *places, known_intensity, faithful, start, bend, light.search_sigma(prior_sigma),
        believed, elevation if light.has_sources else None, kept, zero_sigma_px, uneven, arriving,
    )  # fmt: skip
    found = cells.solve()
    raised = None if rest is None or rest.has_rest else solve_raised(cells, found, rest.gain_sigma)
    if raised is not None:
        cells, found = raised.cells, raised.found
    change = cells.confirmed_change(found, light.confirmed).astype(np.float32).reshape(*size, 2)
    p_change, q_change = (np.ascontiguousarray(change[..., axis]) for axis in (0, 1))
    shadow = found.shadow.astype(np.float32).reshape(size)
    unsure = np.float32(SHADOW_SIGMA) * shadow
    return CellCorrection(
        p_change,
        q_change,
        unsure * p_change,
        unsure * q_change,
        shadow,
        cell,
        SHADOW_WEIGHT,
        partial(_deviations, cells, found, light, raised),
        (~faithful).astype(np.float32).reshape(size),
        has_rest=raised is None,
    )


def _deviations(cells: Cells, found: CellSlopes, light: FittedLight, raised: RaisedField | None) -> SlopePair:
    """Return deviations of slopes p and q, float32 arrays of shape (K, h, w), whose squares add to a variance."""
    sloped = np.linalg.norm(found.slope, axis=1) > LEVEL
    here = np.flatnonzero(cells.faithful & (sloped | (raised is not None)))
    x, y, z = cells.places(found.z_px)
    places = x[here], y[here], z[here]
    slope, incoming = found.slope[here], found.incoming[here]
    shown, design = intensity_changes(cells, found, here)
    change, weight = found.change[here], found.weight[here]
    weighted = change * weight[..., None]
    system = np.swapaxes(weighted, 1, 2) @ change + np.eye(2) / cells.prior_sigma**2

    def moves(missing: Sequence[Float64Array]) -> SlopePair:
        found = np.zeros((len(missing), cells.size[0] * cells.size[1], 2), np.float32)
        gradients = np.einsum("ncj,knc->nkj", weighted, np.asarray(missing))
        found[:, here] = np.moveaxis(np.linalg.solve(system, np.swapaxes(gradients, 1, 2)), -1, 0)
        p, q = (found[..., axis].reshape(-1, *cells.size) for axis in (0, 1))
        return p, q

    p, q = (
        light.confirmed * jackknifed(part)
        for part in moves([shown - model.intensity(slope, places, incoming) for model in light.folds])
    )
    beside = list(_unexplained(light.model, slope)) if light.has_sources else []
    if raised is not None:
        beside += [-design @ deviation for deviation in raised.deviations]
    if not beside:
        return p, q
    more = moves(beside)
    return np.concatenate([p, more[0]]), np.concatenate([q, more[1]])


def _unexplained(model: LightModel, slope: Float64Array) -> Iterator[Float64Array]:
    """Return for each channel the intensity (N, C) that sources did not explain of balls, in proportion to the slope.

    The residual field explains it of balls; skin of another shape may differ by as much.
    """
    sigma = np.sqrt(np.maximum(model.source_sigma**2 - model.sigma**2, 0.0))
    steep = np.linalg.norm(slope, axis=1) / (np.sqrt(0.5) * model.steepest)
    for channel in np.eye(len(sigma)):
        yield steep[:, None] * sigma * channel
