"""Form removal by least squares on the valid pixels (F-operator of ISO 25178-3), and the filter of detail.

A polynomial of degree n has the terms column^i row^j with i + j <= n. Its normal equations are sums over rows and
columns in the form of matrix products, a fraction of a second for 12 megapixels; the matrix depends on the mask only
and is computed once for a surface and its samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from device.surface import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.errors import FilterError, MeasurementError

MAX_DEGREE: Final = 10
ROWS_AT_ONCE: Final = 256

_MIN_EIGENVALUE: Final = 1e-12
"""Smallest eigenvalue of determined normal equations, as a fraction of the largest."""


class FormRemoval(Protocol):
    """Removes the form of surfaces with one mask."""

    def remove(self, z_um: Float32Array) -> Float32Array:
        """Return heights above the form: float32 array of shape (H, W), NaN where invalid."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Basis:
    """Powers of the coordinate along one axis, from -1 to 1: float64 array of shape (side, count)."""

    powers: Float64Array

    @classmethod
    def along(cls, side: int, count: int) -> _Basis:
        return cls(np.linspace(-1.0, 1.0, side)[:, None] ** np.arange(count))


class PolynomialForm:
    """A polynomial in column and row.

    Parameters
    ----------
    valid : bool array of shape (H, W)
    degree : 0 removes the mean, 1 the plane

    Raises
    ------
    MeasurementError
        The degree is too high, or the valid pixels do not determine the polynomial.
    """

    def __init__(self, valid: MaskArray, degree: int) -> None:
        if not 0 <= degree <= MAX_DEGREE:
            raise MeasurementError(f"polynomial of degree {degree}: give 0 to {MAX_DEGREE}")
        self._valid = valid
        self._terms = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)])
        self._down, self._across = (_Basis.along(side, 2 * degree + 1).powers for side in valid.shape)
        moments = self._moments(valid, 2 * degree + 1)
        i, j = self._terms.T
        self._normal = moments[np.add.outer(i, i), np.add.outer(j, j)]
        self._degree = degree
        self._check_determined()

    def remove(self, z_um: Float32Array) -> Float32Array:
        """Return heights above the polynomial: float32 array of shape (H, W), NaN where invalid."""
        level = np.float32(z_um[self._valid].mean(dtype=np.float64))
        filled = np.where(self._valid, z_um - level, np.float32(0.0))
        i, j = self._terms.T
        solution = np.linalg.solve(self._normal, self._moments(filled, self._degree + 1)[i, j])
        grid = np.zeros((self._degree + 1, self._degree + 1))
        grid[i, j] = solution
        count = self._degree + 1
        across = (grid @ self._across[:, :count].T).astype(np.float32)
        filled -= self._down[:, :count].astype(np.float32) @ across
        filled[~self._valid] = np.nan
        return filled

    def _moments(self, values: Float32Array | MaskArray, count: int) -> Float64Array:
        """Return sums of value times row^i column^j: float64 array of shape (count, count)."""
        total = np.zeros((count, count))
        for first in range(0, values.shape[0], ROWS_AT_ONCE):
            rows = slice(first, first + ROWS_AT_ONCE)
            total += self._down[rows, :count].T @ (values[rows].astype(np.float64) @ self._across[:, :count])
        return total

    def _check_determined(self) -> None:
        eigenvalues = np.linalg.eigvalsh(self._normal)
        if not eigenvalues[0] > _MIN_EIGENVALUE * eigenvalues[-1]:
            raise MeasurementError(
                f"{int(self._valid.sum())} valid pixels do not determine a polynomial of degree {self._degree}: "
                "choose a lower degree or a larger region"
            )


# Detail of a height map between an S-filter and an L-filter (paper, section 6.1; ISO 16610-61).
#
# Both are areal Gaussian filters with 50 % transmission at the nesting index. The S-filter removes shorter wavelengths,
# the L-filter longer ones: detail = S-filtered surface minus its L-filtered mean.


@dataclass(frozen=True, slots=True)
class DetailBand:
    """Nesting indices of the S-filter and the L-filter, µm; None for no filter.

    Raises
    ------
    FilterError
        An index is not a positive length, or the S-filter removes all that the L-filter leaves.
    """

    s_um: float | None
    l_um: float | None

    def __post_init__(self) -> None:
        for name, index_um in (("S", self.s_um), ("L", self.l_um)):
            if index_um is not None and not 0.0 < index_um < float("inf"):
                raise FilterError(f"the {name}-filter's nesting index is {index_um:g} µm: give a positive length")
        if self.s_um is not None and self.l_um is not None and self.s_um >= self.l_um:
            raise FilterError(
                f"the S-filter at {self.s_um:g} µm removes all that the L-filter at {self.l_um:g} µm leaves: "
                "give it a smaller nesting index"
            )


def detail(height: HeightMap, band: DetailBand) -> HeightMap:
    """Return the height map between the band's nesting indices, NaN where the height map is invalid."""
    from host_sync.filters.gaussian_regression import gaussian_mean  # compiled code, loaded when it is needed

    z_um = height.z_um if band.s_um is None else gaussian_mean(height.z_um, band.s_um / height.pitch_um)
    if band.l_um is not None:
        z_um = z_um - gaussian_mean(z_um, band.l_um / height.pitch_um)
    return HeightMap(z_um, height.pitch_um)
