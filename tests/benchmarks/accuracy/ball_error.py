"""Errors of one ball press on the twin, by the definitions of the judge of real frames.

* surface: central differences of the height map against the truth's, angle between the normals, inside 0.9 of the
  contact radius; an invalid pixel counts as 15 degrees.
* surface_smooth2: the same after a Gaussian of 2 px on both, inside the contact only: bias without pixel noise.
* radius: of a sphere fitted to the height map there, relative to the true one.

Unlike hand-made labels the twin's truth is exact, so no centre is re-fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from device.surface import Float32Array, HeightMap, surface_slopes
from hal.simulator.bench import TwinTruth

INNER_FRACTION: Final = 0.9
INVALID_DEG: Final = 15.0
SMOOTHING_PX: Final = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class BallError:
    """Errors of one ball press.

    surface_deg, smooth_deg : float arrays of shape (N,), degrees, one per pixel of the inner contact
    masked_share : fraction of those pixels that are invalid
    radius_ratio : fitted over true radius; NaN where no height is valid
    """

    surface_deg: NDArray[np.float64]
    smooth_deg: NDArray[np.float64]
    masked_share: float
    radius_ratio: float


def judge_ball(height: HeightMap, truth: TwinTruth, radius_um: float, camera_um: float = np.inf) -> BallError:
    """Errors of a height map of one pressed ball.

    camera_um : height of the camera over the middle of the untouched skin
    """
    inner = inner_contact(truth.contact)
    p, q = surface_slopes(height)
    seen = inner & np.isfinite(p) & np.isfinite(q)
    invalid = np.full(int(inner.sum() - seen.sum()), INVALID_DEG)
    sharp = _angles_deg((p[seen], q[seen]), (truth.p[seen], truth.q[seen]))
    smooth = _angles_deg(*([_smoothed(part, seen) for part in pair] for pair in ((p, q), (truth.p, truth.q))))
    return BallError(
        surface_deg=np.concatenate([sharp, invalid]),
        smooth_deg=np.concatenate([smooth, invalid]),
        masked_share=len(invalid) / int(inner.sum()),
        radius_ratio=_fitted_radius_um(height, seen, camera_um) / radius_um,
    )


def inner_contact(contact: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Contact pixels within 0.9 of the contact radius: farther from the rim than a tenth of its largest inscribed
    radius."""
    depth = np.asarray(distance_transform_edt(contact))
    return np.asarray(depth > (1.0 - INNER_FRACTION) * depth.max())


def _angles_deg(
    found: tuple[Float32Array, Float32Array] | list[NDArray[np.float64]],
    true: tuple[Float32Array, Float32Array] | list[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Angles between two sets of normals given by slopes (p, q), float64 array of shape (N,), degrees."""
    (p, q), (pt, qt) = ([part.astype(np.float64) for part in pair] for pair in (found, true))
    norms = np.sqrt((1.0 + p**2 + q**2) * (1.0 + pt**2 + qt**2))
    cosine = (p * pt + q * qt + 1.0) / norms
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _smoothed(values: Float32Array, inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Gaussian mean over the pixels inside only, at those pixels: float64 array of shape (N,)."""
    total = gaussian_filter(np.where(inside, values, 0.0).astype(np.float64), SMOOTHING_PX)
    share = gaussian_filter(inside.astype(np.float64), SMOOTHING_PX)
    return np.asarray(total[inside] / share[inside])


def _fitted_radius_um(height: HeightMap, inside: NDArray[np.bool_], camera_um: float) -> float:
    """Radius (µm) of the sphere that fits the height best in the algebraic sense; NaN without pixels."""
    row, column = np.nonzero(inside)
    if len(row) == 0:
        return float("nan")
    z = height.z_um[inside].astype(np.float64) / height.pitch_um
    closer = 1.0 - z * height.pitch_um / camera_um
    x, y = ((place - 0.5 * (side - 1)) * closer for place, side in zip((column, row), inside.shape[::-1], strict=True))
    design = np.column_stack([2.0 * x, 2.0 * y, 2.0 * z, np.ones_like(z)])
    solved = np.linalg.lstsq(design, x * x + y * y + z * z, rcond=None)[0]
    return float(np.sqrt(max(solved[3] + (solved[:3] ** 2).sum(), 0.0)) * height.pitch_um)
