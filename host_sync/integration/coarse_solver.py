"""Direct solution on the coarsest level: by cosine transform where every edge weighs 1, else by the pseudo-inverse.

The coarse levels of a full rectangle of even size are full rectangles too. The discrete cosine transform solves these
exactly, in less time than calling the kernels of many small levels takes. (Cells at an odd end are smaller: from there
on levels have weights.)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Final

import numpy as np
from scipy.fft import dctn, idctn

from device.surface.fields import Float32Array, Float64Array
from device.surface.poisson_dct import eigenvalues
from host_sync.integration.levels import GridLevel, edge_weights
from host_sync.kernels.jit import get_num_threads

NULL_TOLERANCE: Final = 1e-10
"""Eigenvalue of D^-½ A D^-½ below which a mode counts as the free mean of a component."""

DirectSolver = Callable[[GridLevel], None]
"""Writes a level's heights from its right-hand side; the cosine solver makes their mean zero."""


def direct_solver(level: GridLevel) -> DirectSolver:
    """The solver for this level, for any right-hand side."""
    if level.weight_x is None:
        return _solve_by_cosines
    return partial(_solve_by_inverse, pseudo_inverse(level))


def pseudo_inverse(level: GridLevel) -> Float64Array:
    """Pseudo-inverse of a small level's Laplacian, float64 array (H·W, H·W): least squares, free means zero."""
    weight_x, weight_y = (weights.astype(np.float64) for weights in edge_weights(level))
    rows, columns = level.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    laplacian = np.zeros((index.size, index.size))
    laplacian[index[:, 1:], index[:, :-1]] = -weight_x[:, 1:-1]
    laplacian[index[1:], index[:-1]] = -weight_y[1:-1]
    laplacian += laplacian.T
    diagonal = -laplacian.sum(axis=1)
    laplacian[np.diag_indices_from(laplacian)] = diagonal
    scale = np.divide(1.0, np.sqrt(diagonal), out=np.zeros_like(diagonal), where=diagonal > 0.0)
    inverse = np.linalg.pinv(scale[:, None] * laplacian * scale, rcond=NULL_TOLERANCE, hermitian=True)
    return np.asarray(scale[:, None] * inverse * scale, np.float64)


def write_divergence(level: GridLevel) -> None:
    """Write the level's right-hand side, the divergence of its edges' weighted slopes."""
    slope_x, slope_y = level.slope_x, level.slope_y
    if level.weight_x is not None and level.weight_y is not None:
        slope_x, slope_y = level.weight_x * slope_x, level.weight_y * slope_y
    np.subtract(slope_x[:, :-1], slope_x[:, 1:], out=level.rhs)
    level.rhs += slope_y[:-1]
    level.rhs -= slope_y[1:]


def _solve_by_inverse(inverse: Float64Array, level: GridLevel) -> None:
    z: Float32Array = (inverse @ level.rhs.ravel().astype(np.float64)).astype(np.float32)
    level.z[:] = z.reshape(level.shape)


def _solve_by_cosines(level: GridLevel) -> None:
    """In double precision: single precision leaves errors in the longest waves, which no finer level removes."""
    threads = get_num_threads()
    spectrum = dctn(level.rhs.astype(np.float64), type=2, norm="ortho", overwrite_x=True, workers=threads)
    spectrum *= _inverse_eigenvalues(level.shape)
    level.z[:] = idctn(spectrum, type=2, norm="ortho", overwrite_x=True, workers=threads)


@lru_cache(maxsize=4)
def _inverse_eigenvalues(shape: tuple[int, int]) -> Float64Array:
    """Inverse eigenvalues of the Laplacian, float64 array of this shape; 0 for the mean."""
    return np.asarray(1.0 / eigenvalues(shape))
