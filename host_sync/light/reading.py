"""Slopes of a frame by the light model: what those of the inverse map gain over cells, and over a raised field."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.skin_at_rest import RestEvidence
from device.surface import Float32Array, Float64Array, GradientField
from host_sync.denoising.slope_noise import BLUR_PX
from host_sync.integration.datum import cell_means
from host_sync.kernels.cell_rows import (
    WHOLE_CELL,
    WIDEST_CELLS,
    bordered,
    expanded_at,
    means_of_cells,
    middles_of_cells,
)
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.light.cells import SHADOW_WEIGHT, Cells, CellSlopes
from host_sync.light.model import ELEVATION, LightModel
from host_sync.uncertainty.calibration_uncertainty import jackknifed
from host_sync.uncertainty.elevation import ElevationCorrection

if TYPE_CHECKING:
    from host_sync.light.fit import FittedLight

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
    relative_sigma = np.float32(SHADOW_SIGMA) * shadow
    return CellCorrection(
        p_change,
        q_change,
        relative_sigma * p_change,
        relative_sigma * q_change,
        shadow,
        cell,
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


# Cells of bent skin: what their mean light hides of their slope.
#
# A coat answers to the direction of its normal, and light adds up over a cell. The mean of unit normals, (-p, -q, 1)
# over √(1 + p² + q²), leans less than the mean slope says. On the edge of a step that hides up to a micrometre of
# height, on a ball a thousandth of that.

SAMPLES: Final = 4
"""Pixels along a cell whose slopes are asked, at least."""

MAX_HIDDEN: Final = 0.1
"""Share of a cell's slope that may be hidden; slopes that differ by more are misread."""


def slopes_hidden_by_means(
    gradients: GradientField, size: tuple[int, int], cell: int
) -> tuple[Float64Array, Float64Array]:
    """Return how much mean slopes of `size` (h, w) cells are steeper than their mean light shows, shape (h, w, 2).

    Over a cell slopes differ as pixels show, and within a pixel as they change over the camera's blur. The other array,
    of shape (h, w, 3), holds the covariance of the pixels' normals: of their components along columns, of both, and
    along rows.

    gradients : slopes of pixels
    cell : pixels along a cell
    """
    sums = np.zeros((12, *size), np.float32)
    step = max(1, cell // SAMPLES)
    parallel_rows(_add_normals, size, gradients.p, gradients.q, gradients.valid, cell, step, sums)
    means = sums.astype(np.float64) / np.maximum(sums[8], 1.0)
    p, q, p_normal, q_normal, normal, pp, pq, qq = means[:8]
    spread = means[9:] - np.stack([p_normal * p_normal, p_normal * q_normal, q_normal * q_normal])
    square, normal = 1.0 + p * p + q * q, np.maximum(normal, 1e-6)
    blur = 0.25 * BLUR_PX**2
    p_hidden = p - p_normal / normal + blur * (pp * p + pq * q) / square
    q_hidden = q - q_normal / normal + blur * (pq * p + qq * q) / square
    share = np.hypot(p_hidden, q_hidden) / np.maximum(np.sqrt(square - 1.0), 1e-12)
    believed = np.minimum(1.0, MAX_HIDDEN / np.maximum(share, 1e-12))
    return np.stack([believed * p_hidden, believed * q_hidden], axis=-1), np.moveaxis(spread, 0, -1)


@njit(cache=True, nogil=True)
def _add_normals(p: Any, q: Any, valid: Any, cell: int, step: int, sums: Any, first: int, last: int) -> None:
    """Add up slopes, normals, products of slopes' differences over two pixels, and valid pixels, in rows of cells."""
    rows, columns = valid.shape
    one = np.float32(1.0)
    own = np.empty(len(sums), np.float32)
    for i in range(first, last):
        for j in range(sums.shape[2]):
            own[:] = 0.0
            begin = step // 2 + (max(j * cell - step // 2, 0) + step - 1) // step * step
            end = min((j + 1) * cell, columns)
            for r in range(i * cell + step // 2, min((i + 1) * cell, rows), step):
                for c in range(begin, end, step):
                    if not valid[r, c]:
                        continue
                    x, y = p[r, c], q[r, c]
                    normal = one / np.sqrt(one + x * x + y * y)
                    own[0] += x
                    own[1] += y
                    own[2] += x * normal
                    own[3] += y * normal
                    own[4] += normal
                    own[8] += one
                    own[9] += x * normal * x * normal
                    own[10] += x * normal * y * normal
                    own[11] += y * normal * y * normal
                    inner = 0 < r < rows - 1 and 0 < c < columns - 1
                    if inner and valid[r - 1, c] and valid[r + 1, c] and valid[r, c - 1] and valid[r, c + 1]:
                        px, py = p[r, c + 1] - p[r, c - 1], p[r + 1, c] - p[r - 1, c]
                        qx, qy = q[r, c + 1] - q[r, c - 1], q[r + 1, c] - q[r - 1, c]
                        own[5] += px * px + py * py
                        own[6] += px * qx + py * qy
                        own[7] += qx * qx + qy * qy
            sums[:, i, j] = own


# Elevation of a field in which no skin rests, and gains of its frame.
#
# Near light reaches raised skin at another angle and from less far. The channels determine two slopes of every cell.
# What slopes cannot explain varies over the field by one pattern with elevation, and by others with the gain of every
# channel.

ROUNDS: Final = 8
STEPS: Final = 2
"""Rounds in which elevation and heights are found in turns, and steps of the slopes in each."""

INDEPENDENT: Final = 64.0
"""Places of a field at which errors of the model do not go together."""

UNSHADED: Final = 0.1
"""Hidden fraction of the light up to which a cell is counted."""

STEP: Final = 0.02 * ELEVATION

MIN_CELLS: Final = 200
MIN_SIGMAS: Final = 3.0
"""Standard uncertainties by which an elevation differs from none, at least."""


@dataclass(frozen=True, slots=True, eq=False)
class RaisedField:
    """Slopes of a field whose skin is raised as a whole.

    cells : with intensity under the calibration's gains
    found : their slopes
    deviations : of elevation (widths of the field) and logarithms of gains, whose squares add to their variances and
        products to their covariances: float64 array of shape (1 + C, 1 + C)
    """

    cells: Cells
    found: CellSlopes
    deviations: Float64Array


def solve_raised(cells: Cells, found: CellSlopes, gain_sigma: float) -> RaisedField | None:
    """Return slopes over the elevation of the field; None where light does not show that it is raised.

    found : slopes over the elevation that level skin in it shows
    gain_sigma : standard deviation of a frame's gains
    """
    if not len(cells.model.sources):
        return None
    channels = cells.intensity.shape[1]
    prior = np.diag([ELEVATION**-2] + [gain_sigma**-2] * channels)
    change, raised = np.zeros(1 + channels), cells
    for _ in range(ROUNDS):
        usable = cells.faithful & (found.shadow < UNSHADED)
        if np.count_nonzero(usable) < MIN_CELLS:
            return None
        system, gradient = _normal_equations(raised, found, usable)
        covariance = np.linalg.inv(system + prior)
        change += covariance @ (gradient - prior @ change)
        raised = replace(cells, intensity=cells.intensity * np.exp(-change[1:]))
        found = raised.solve_raised(found, change[0] * cells.model.shape[1], STEPS)
    if abs(change[0]) < MIN_SIGMAS * np.sqrt(covariance[0, 0]):
        return None
    size, along = np.linalg.eigh(covariance)
    return RaisedField(raised, found, (along * np.sqrt(size)).T)


def intensity_changes(cells: Cells, found: CellSlopes, here: np.ndarray) -> tuple[Float64Array, Float64Array]:
    """Return the model's intensity (N, C) of some cells and its derivatives by elevation and gains, (N, C, 1 + C).

    The residual field adds nothing to the derivative by elevation, for balls show elevation with tilt only.
    """
    x, y, z = (part[here] for part in cells.places(found.z_px))
    shown = cells.model.intensity(found.slope[here], (x, y, z), found.incoming[here])
    raised = cells.model.elevated(found.slope[here], (x, y, z), z + STEP) / STEP
    return shown, np.concatenate([raised[:, :, None], shown[:, :, None] * np.eye(shown.shape[1])], axis=2)


def _normal_equations(cells: Cells, found: CellSlopes, usable: np.ndarray) -> tuple[Float64Array, Float64Array]:
    """Return the system and the gradient of elevation and gains, once slopes follow them."""
    here = np.flatnonzero(usable)
    shown, design = intensity_changes(cells, found, here)
    slopes, weight = found.change[here], found.weight[here]
    known = cells.prior_weight(found)[here, None, None] * np.eye(2)
    own = np.einsum("ncj,nc,nck->njk", slopes, weight, slopes) + known
    mixed = np.einsum("ncj,nc,nck->njk", slopes, weight, design)
    system = np.einsum("ncj,nc,nck->jk", design, weight, design)
    system -= np.einsum("nij,nik->jk", mixed, np.linalg.solve(own, mixed))
    gradient = np.einsum("ncj,nc,nc->j", design, weight, cells.intensity[here] - shown)
    fraction = INDEPENDENT / len(here)
    return fraction * system, fraction * gradient


# Correction of pixels' slopes that is found at the middles of cells: of long waves, so that few places are enough.

SlopePair = tuple[Float32Array, Float32Array]


@dataclass(frozen=True, slots=True, eq=False)
class CellCorrection:
    """Change of pixels' slopes, at the middles of cells.

    p, q : float32 arrays of shape (h, w), to be added
    sigma_p, sigma_q : float32 arrays of shape (h, w), with sign, standard uncertainties of slopes there, all at once
    shadow : float32 array of shape (h, w), 0 where every light arrives, 1 where one does not
    cell : pixels along a cell
    slope_deviations : returns float32 arrays of shape (K, h, w), deviations of slopes p and q whose squares add to a
        variance, each wrong all at once; called once, in the background; None where nothing is known of them
    left_alone : float32 array of shape (h, w), how much slopes are as the map reads them, so that what is not known of
        the map counts: 1 where a pixel is saturated, or the correction does not explain what is seen; else 0
    has_rest : whether some skin may be untouched; False where an object lies under the whole field, as the light shows
    """

    p: Float32Array
    q: Float32Array
    sigma_p: Float32Array
    sigma_q: Float32Array
    shadow: Float32Array
    cell: int
    slope_deviations: Callable[[], SlopePair] | None = None
    left_alone: Float32Array | None = None
    has_rest: bool = True

    def apply(self, gradients: GradientField) -> None:
        """Write corrected slopes and weights over those of a gradient field (H, W)."""
        less = np.float32(SHADOW_WEIGHT - 1.0) * self.shadow
        planes = bordered(np.stack([self.p, self.q, less]))
        parallel_rows(_apply, gradients.p.shape, planes, self.cell, gradients.p, gradients.q, gradients.weight)

    def sigma(self, size: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
        """Return the standard uncertainties of slopes p and q in shadow, with sign, on a field of `size` (w, h)."""
        p, q = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (self.sigma_p, self.sigma_q))
        return np.asarray(p, np.float32), np.asarray(q, np.float32)


@njit(cache=True, nogil=True)
def _apply(planes: Any, cell: int, p: Any, q: Any, weight: Any, first: int, last: int) -> None:
    """Add the first two planes of cells to slopes, and the third times the weight to it, in rows."""
    upper, step = np.empty((len(planes), p.shape[1]), np.float32), np.empty((len(planes), p.shape[1]), np.float32)
    expanded = -1
    for r in range(first, last):
        expanded, share = expanded_at(planes, r, cell, expanded, upper, step)
        for c in range(p.shape[1]):
            p[r, c] += upper[0, c] + share * step[0, c]
            q[r, c] += upper[1, c] + share * step[1, c]
            weight[r, c] += weight[r, c] * (upper[2, c] + share * step[2, c])
