"""Real spherical harmonics of the surface normal, and reflectance as their sum (paper, eq. 3).

The basis is written in the Cartesian components of the normal, Y = N · d^m P_l/dz^m · (Re or Im)(x + iy)^m, so values
and derivatives are polynomials and nothing is singular at the pole, where the flat skin lies.

Balls show only a cap of the sphere of normals, over which high orders are nearly dependent. Orders above 2 are
therefore penalized by the square of their Laplacian, l²(l + 1)², so that beyond the observed slopes the sum stays close
to the Lambertian approximation (orders 0 to 2, practically unpenalized).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial, pi, sqrt
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.polynomial import legendre, polynomial
from numpy.typing import NDArray

from device.balls.sphere import BallSamples
from device.errors import CalibrationError
from device.surface import Float32Array, Float64Array, MaskArray

if TYPE_CHECKING:
    from scipy.interpolate import RectBivariateSpline


LAMBERTIAN_ORDER: Final = 2
FULL_ORDER: Final = 5

PENALTY: Final = 1e-6
"""Weight of the squared Laplacian of orders above 2, per unit of total weight."""

NUMERICAL_PENALTY: Final = 1e-10
"""The same for orders 1 and 2: only keeps a shallow cap solvable."""

COUNT_CAP: Final = 50
"""Upper bound of the weight of a cell, its count: beyond it the error comes from the skin, not from pixel noise."""


@dataclass(frozen=True, slots=True, eq=False)
class HarmonicFit:
    """Reflectance of each channel as a sum of spherical harmonics of the normal.

    order : highest order of the sum
    coefficients : float64 array of shape ((order + 1)², 3)
    residual : root mean square residual of the observed cells, intensity, one per channel
    """

    order: int
    coefficients: Float64Array
    residual: tuple[float, float, float]

    def reflectance(self, p: NDArray[Any], q: NDArray[Any]) -> Float64Array:
        """R(p, q), float64 array of shape (N, 3), for slopes of shape (N,)."""
        return np.asarray(harmonics(p, q, self.order)[0] @ self.coefficients)

    def with_jacobian(self, p: NDArray[Any], q: NDArray[Any]) -> tuple[Float64Array, Float64Array]:
        """R of shape (N, 3) and J = (∂R/∂p, ∂R/∂q) of shape (N, 3, 2) (paper, eq. 4)."""
        value, by_p, by_q = harmonics(p, q, self.order)
        jacobian = np.stack([by_p @ self.coefficients, by_q @ self.coefficients], axis=-1)
        return np.asarray(value @ self.coefficients), jacobian


def harmonics(p: NDArray[Any], q: NDArray[Any], order: int) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Y, ∂Y/∂p and ∂Y/∂q at slopes of shape (N,): float64 arrays of shape (N, (order + 1)²)."""
    p, q = np.asarray(p, np.float64), np.asarray(q, np.float64)
    z = 1.0 / np.sqrt(1.0 + p * p + q * q)
    normal = (-p * z, -q * z, z)
    value, by_normal = harmonics_of_normal(*normal, order)
    by_p, by_q = (_chain(by_normal, normal, slope, axis) for axis, slope in enumerate((p, q)))
    return value, by_p, by_q


def _chain(
    by_normal: tuple[Float64Array, ...], normal: tuple[Float64Array, ...], slope: Float64Array, axis: int
) -> Float64Array:
    """Return the derivative along a slope: ∂n/∂slope = -(e_axis z + n slope z²)."""
    z = normal[2]
    total = np.zeros_like(by_normal[0])
    for component, (derivative, part) in enumerate(zip(by_normal, normal, strict=True)):
        rate = -part * slope * z * z - (z if component == axis else 0.0)
        total += derivative * rate[:, None]
    return total


def harmonics_of_normal(
    x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], order: int
) -> tuple[Float64Array, tuple[Float64Array, Float64Array, Float64Array]]:
    """Y at unit normals of shape (N,), and its partial derivatives along x, y and z.

    Columns are orders 0, 1, …, and within order l, m = -l … l: N by (order + 1)².
    """
    x, y, z = (np.asarray(part, np.float64) for part in (x, y, z))
    powers = np.ones((order + 1, len(x)), np.complex128)
    for m in range(1, order + 1):
        powers[m] = powers[m - 1] * (x + 1j * y)
    value, by_x, by_y, by_z = (np.empty((len(x), (order + 1) ** 2)) for _ in range(4))
    for column, (degree, m) in enumerate(_terms(order)):
        scale, along_z, along_z_rate = _polar(degree, abs(m))
        polar = scale * polynomial.polyval(z, along_z)
        lower = abs(m) * powers[abs(m) - 1] if m else np.zeros(len(x), np.complex128)
        turn, rate_x, rate_y = (part.imag if m < 0 else part.real for part in (powers[abs(m)], lower, 1j * lower))
        value[:, column] = polar * turn
        by_x[:, column], by_y[:, column] = polar * rate_x, polar * rate_y
        by_z[:, column] = scale * polynomial.polyval(z, along_z_rate) * turn
    return value, (by_x, by_y, by_z)


def _terms(order: int) -> list[tuple[int, int]]:
    return [(degree, m) for degree in range(order + 1) for m in range(-degree, degree + 1)]


def _polar(degree: int, m: int) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    """Normalization, and the coefficients of d^m P_l/dz^m and of its derivative."""
    scale = sqrt((2 * degree + 1) / (4 * pi) * factorial(degree - m) / factorial(degree + m) * (2 if m else 1))
    along_z = polynomial.polyder(legendre.leg2poly([0] * degree + [1]), m)
    return scale, tuple(along_z), tuple(polynomial.polyder(along_z))


def fit_harmonics(maps: ReflectanceMaps, order: int = FULL_ORDER) -> HarmonicFit:
    """Count-weighted, regularized fit to the observed cells (paper, eq. 3)."""
    row, column = np.nonzero(maps.observed)
    design = harmonics(maps.centres[column], maps.centres[row], order)[0]
    mean = maps.mean[row, column]
    weight = np.minimum(maps.count[row, column], COUNT_CAP).astype(np.float64)
    weighted = design * weight[:, None]
    penalty = np.array([_penalty(degree) for degree, _ in _terms(order)])
    gram = weighted.T @ design + np.diag(weight.sum() * penalty)
    coefficients = np.asarray(np.linalg.solve(gram, weighted.T @ mean), np.float64)
    square = (weight[:, None] * (mean - design @ coefficients) ** 2).sum(axis=0) / weight.sum()
    red, green, blue = (float(value) for value in np.sqrt(square))
    return HarmonicFit(order, coefficients, (red, green, blue))


def _penalty(degree: int) -> float:
    laplacian = float((degree * (degree + 1)) ** 2)
    return (PENALTY if degree > LAMBERTIAN_ORDER else NUMERICAL_PENALTY) * laplacian


# Reflectance as a smooth function of slope, from which the table is filled: observed values, with order 5 around them.
#
# R = harmonics + smoothed remainder. The remainder of the observed cells is averaged over neighbours and shrunk towards
# zero by its uncertainty, so it fades out where nothing was observed and the harmonics continue without a seam. A
# bicubic spline gives value and Jacobian at every slope.

EXTENSION: Final = 0.08
"""Extent of the surface beyond the steepest observed slope, as a fraction of it."""

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
    """Return the surface through the observed maps, extended a little by the harmonics."""
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
    """Return the observed minus modelled reflectance, averaged and shrunk, on the extended grid.

    The remainder has a variance of its own, and an observed cell adds the scatter over its count. Their ratio is the
    count at which the remainder is shrunk to half; it is 1 where small balls show no slope twice, and so no scatter.
    """
    from scipy.ndimage import gaussian_filter  # here, because only calibrating needs it

    seen = maps.observed
    count = np.pad(np.where(seen, maps.count, 0).astype(np.float64), margin)
    remainder = np.pad(np.where(seen[..., None], maps.mean - model, 0.0), ((margin, margin), (margin, margin), (0, 0)))
    cells = 4.0 * np.pi * SMOOTHING_CELLS**2
    scatter = float(np.mean(maps.scatter**2))
    total = count.sum()
    own = float((count[..., None] * remainder**2).sum() / (3.0 * total)) - scatter * float(seen.sum()) / total
    half_count = scatter / max(own, 1e-3 * scatter) if scatter > 0.0 else 1.0
    weight = cells * gaussian_filter(count, SMOOTHING_CELLS, mode="constant")
    spread = (SMOOTHING_CELLS, SMOOTHING_CELLS, 0.0)
    sums = cells * gaussian_filter(remainder * count[..., None], spread, mode="constant")
    return np.asarray(sums / (weight + half_count)[..., None], np.float64)


# Reflectance maps: observed intensities of balls on a fixed grid of slopes (paper, section 5.1).

CELLS: Final = 97
"""Cells along each axis of the slope grid; odd, so that one cell is centred on the flat skin."""

SLOPE_PERCENTILE: Final = 99.9
"""Percentile of the observed slopes that the grid must cover: a single steep pixel must not coarsen it."""

MIN_CELLS: Final = 60
"""Observed cells needed to determine the 36 harmonics of order 5."""


@dataclass(frozen=True, slots=True, eq=False)
class ReflectanceMaps:
    """Observed intensity by slope, one map per channel; rows of a map are q, columns are p.

    reach : slope at the outer border of the grid, which spans -reach to reach in p and q
    mean : float64 array of shape (CELLS, CELLS, 3), NaN where nothing was observed
    variance : float64 array of shape (CELLS, CELLS, 3), within a cell, NaN with fewer than two pixels
    count : int array of shape (CELLS, CELLS), pixels
    """

    reach: float
    mean: Float64Array
    variance: Float64Array
    count: NDArray[np.int64]

    @property
    def cell(self) -> float:
        """Width of a cell, slope."""
        return 2.0 * self.reach / len(self.count)

    @property
    def centres(self) -> Float64Array:
        """Slopes at the centres of the cells along either axis, float64 array of shape (CELLS,)."""
        return np.asarray((np.arange(len(self.count)) + 0.5) * self.cell - self.reach, np.float64)

    @property
    def observed(self) -> MaskArray:
        """True where a cell holds a pixel, shape (CELLS, CELLS)."""
        return np.asarray(self.count > 0)

    @property
    def scatter(self) -> Float64Array:
        """Standard deviation of intensity at one slope, pooled over cells, float64 array of shape (3,).

        It includes everything that slope does not explain: pixel noise, texture of the skin, position in the field.
        """
        seen = self.count > 1
        freedom = (self.count[seen] - 1)[:, None]
        pooled = (self.variance[seen] * freedom).sum(axis=0) / max(float(freedom.sum()), 1.0)
        return np.asarray(np.sqrt(pooled), np.float64)


def sample_reflectance(samples: BallSamples) -> ReflectanceMaps:
    """Return the mean, variance and count of intensity in every cell of the slope grid.

    Raises
    ------
    CalibrationError
        The balls show too few different slopes.
    """
    reach = _reach(samples.p, samples.q)
    cell = 2.0 * reach / CELLS
    column, row = (np.floor((slope + reach) / cell).astype(np.intp) for slope in (samples.p, samples.q))
    inside = (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
    index = row[inside] * CELLS + column[inside]
    count = np.bincount(index, minlength=CELLS * CELLS)
    mean, variance = _moments(index, samples.intensity[inside], count)
    maps = ReflectanceMaps(reach, mean, variance, count.reshape(CELLS, CELLS))
    seen = int(maps.observed.sum())
    if seen < MIN_CELLS:
        raise CalibrationError(
            f"the balls show only {seen} different slopes: press the ball deeper and calibrate again"
        )
    return maps


def _reach(p: Float32Array, q: Float32Array) -> float:
    if len(p) == 0:
        raise CalibrationError("no usable pixel inside a ball's contact: lower the exposure and calibrate again")
    steepest = float(np.percentile(np.hypot(p, q), SLOPE_PERCENTILE))
    return max(1.02 * steepest, 1e-3)


def _moments(index: NDArray[np.intp], values: Float32Array, count: NDArray[np.int64]) -> tuple[Float64Array, ...]:
    """Return the mean and unbiased variance by cell, each of shape (CELLS, CELLS, 3)."""
    shape = (CELLS, CELLS, 3)
    mean, variance = np.full((count.size, 3), np.nan), np.full((count.size, 3), np.nan)
    some, several = count > 0, count > 1
    for channel in range(3):
        value = values[:, channel].astype(np.float64)
        mean[some, channel] = np.bincount(index, value, minlength=count.size)[some] / count[some]
        square = np.bincount(index, (value - mean[index, channel]) ** 2, minlength=count.size)
        variance[several, channel] = square[several] / (count[several] - 1)
    return mean.reshape(shape), variance.reshape(shape)
