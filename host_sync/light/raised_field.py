"""Elevation of a field in which no skin rests, and gains of its frame.

Near light reaches raised skin at another angle and from less far. The channels determine two slopes of every cell. What
slopes cannot explain varies over the field by one pattern with elevation, and by others with the gain of every channel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.surface.fields import Float64Array
from host_sync.light.cells import Cells, CellSlopes
from host_sync.light.model import ELEVATION

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
