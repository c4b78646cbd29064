"""Reflectance as a smooth function of slope, from which the table is filled: observed values, with order 5 around them.

R = harmonics + smoothed remainder. The remainder of the observed cells is averaged over neighbours and shrunk towards
zero by its uncertainty, so it fades out where nothing was observed and the harmonics continue without a seam. A bicubic
spline gives value and Jacobian at every slope.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float64Array
from host_sync.johnson2009.reflectance_map import ReflectanceMaps
from host_sync.johnson2009.spherical_harmonics import HarmonicFit

if TYPE_CHECKING:
    from scipy.interpolate import RectBivariateSpline

EXTENSION: Final = 0.08
"""How far the surface extends beyond the steepest observed slope, as a fraction of it."""

SMOOTHING_CELLS: Final = 1.5
"""Standard deviation of the Gaussian over the remainder, cells."""


@dataclass(frozen=True, slots=True, eq=False)
class ReflectanceSurface:
    """R(p, q) within `reach`, from one spline per channel over the slope grid."""

    reach: float
    splines: tuple[RectBivariateSpline, ...]

    def on_grid(self, slopes: Float64Array) -> Float64Array:
        """R on the square grid of `slopes` (N,), float64 array of shape (N, N, 3); rows are q, columns p."""
        return np.stack([spline(slopes, slopes) for spline in self.splines], axis=-1)

    def with_jacobian(self, p: NDArray[Any], q: NDArray[Any]) -> tuple[Float64Array, Float64Array]:
        """R of shape (N, 3) and J = (∂R/∂p, ∂R/∂q) of shape (N, 3, 2) (paper, eq. 4) at slopes of shape (N,)."""
        value = np.stack([spline.ev(q, p) for spline in self.splines], axis=-1)
        by_p = np.stack([spline.ev(q, p, dy=1) for spline in self.splines], axis=-1)
        by_q = np.stack([spline.ev(q, p, dx=1) for spline in self.splines], axis=-1)
        return value, np.stack([by_p, by_q], axis=-1)


def reflectance_surface(maps: ReflectanceMaps, harmonics: HarmonicFit) -> ReflectanceSurface:
    """Surface through the observed maps, extended a little by the harmonics."""
    from scipy.interpolate import RectBivariateSpline  # here, because reading the fitted model needs no spline

    margin = int(np.ceil(EXTENSION * len(maps.count) / 2)) + 2
    size = len(maps.count) + 2 * margin
    slopes = (np.arange(size) + 0.5) * maps.cell - maps.reach - margin * maps.cell
    p, q = np.meshgrid(slopes, slopes)
    values = harmonics.reflectance(p.ravel(), q.ravel()).reshape(size, size, 3)
    inner = slice(margin, margin + len(maps.count))
    model = values[inner, inner]
    values = values + _smoothed_remainder(maps, model, margin)
    splines = tuple(RectBivariateSpline(slopes, slopes, values[..., channel]) for channel in range(3))
    return ReflectanceSurface((1.0 + EXTENSION) * maps.reach, splines)


def _smoothed_remainder(maps: ReflectanceMaps, model: Float64Array, margin: int) -> Float64Array:
    """Observed minus modelled reflectance, averaged and shrunk, on the extended grid.

    The remainder has a variance of its own, and an observed cell adds the scatter over its count. Their ratio is the
    count at which the remainder is shrunk to half.
    """
    from scipy.ndimage import gaussian_filter  # here, because only calibrating needs it

    seen = maps.observed
    count = np.pad(np.where(seen, maps.count, 0).astype(np.float64), margin)
    remainder = np.pad(np.where(seen[..., None], maps.mean - model, 0.0), ((margin, margin), (margin, margin), (0, 0)))
    cells = 4.0 * np.pi * SMOOTHING_CELLS**2
    scatter = float(np.mean(maps.scatter**2))
    total = count.sum()
    own = float((count[..., None] * remainder**2).sum() / (3.0 * total)) - scatter * float(seen.sum()) / total
    half_count = scatter / max(own, 1e-3 * scatter)
    weight = cells * gaussian_filter(count, SMOOTHING_CELLS, mode="constant")
    spread = (SMOOTHING_CELLS, SMOOTHING_CELLS, 0.0)
    sums = cells * gaussian_filter(remainder * count[..., None], spread, mode="constant")
    return np.asarray(sums / (weight + half_count)[..., None], np.float64)
