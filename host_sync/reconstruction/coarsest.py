"""Direct solution on the coarsest level: by cosines where every edge weighs 1, else by the pseudo-inverse.

A full rectangle's coarse levels are full rectangles themselves, whose least squares the discrete cosine transform
solves at once, in less time than so many kernels take to be called for so few pixels. (The cells at an odd end are
smaller than others: from there on levels have weights.)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Final

import numpy as np
from numba import get_num_threads
from scipy.fft import dctn, idctn

from device.fft_integrator import eigenvalues
from device.surface import Float32Array, Float64Array
from host_sync.reconstruction.grid_level import GridLevel, edge_weights

LOOSE: Final = 1e-10
"""Eigenvalue of D^-½ A D^-½ below which a mode is the free level of an island."""

DirectSolver = Callable[[GridLevel], None]
"""Writes a level's heights from its right-hand side; by cosines they have mean zero."""


def direct_solver(level: GridLevel) -> DirectSolver:
    """What solves this level, for any right-hand side."""
    if level.across is None:
        return _solve_by_cosines
    return partial(_solve_by_inverse, pseudo_inverse(level))


def pseudo_inverse(level: GridLevel) -> Float64Array:
    """Pseudo-inverse of a small level's Laplacian, float64 array (H·W, H·W): least squares, free levels nought."""
    across, down = (weights.astype(np.float64) for weights in edge_weights(level))
    rows, columns = level.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    laplacian = np.zeros((index.size, index.size))
    laplacian[index[:, 1:], index[:, :-1]] = -across[:, 1:-1]
    laplacian[index[1:], index[:-1]] = -down[1:-1]
    laplacian += laplacian.T
    diagonal = -laplacian.sum(axis=1)
    laplacian[np.diag_indices_from(laplacian)] = diagonal
    scale = np.divide(1.0, np.sqrt(diagonal), out=np.zeros_like(diagonal), where=diagonal > 0.0)
    inverse = np.linalg.pinv(scale[:, None] * laplacian * scale, rcond=LOOSE, hermitian=True)
    return np.asarray(scale[:, None] * inverse * scale, np.float64)


def write_divergence(level: GridLevel) -> None:
    """Write the level's right-hand side: what its edges' weighted slopes bring in less what they take out."""
    slope_across, slope_down = level.slope_across, level.slope_down
    if level.across is not None and level.down is not None:
        slope_across, slope_down = level.across * slope_across, level.down * slope_down
    np.subtract(slope_across[:, :-1], slope_across[:, 1:], out=level.rhs)
    level.rhs += slope_down[:-1]
    level.rhs -= slope_down[1:]


def _solve_by_inverse(inverse: Float64Array, level: GridLevel) -> None:
    z: Float32Array = (inverse @ level.rhs.ravel().astype(np.float64)).astype(np.float32)
    level.z[:] = z.reshape(level.shape)


def _solve_by_cosines(level: GridLevel) -> None:
    """Double precision: single precision leaves errors in the longest waves, which no finer level takes away."""
    threads = get_num_threads()
    spectrum = dctn(level.rhs.astype(np.float64), type=2, norm="ortho", overwrite_x=True, workers=threads)
    spectrum *= _inverse_eigenvalues(level.shape)
    level.z[:] = idctn(spectrum, type=2, norm="ortho", overwrite_x=True, workers=threads)


@lru_cache(maxsize=4)
def _inverse_eigenvalues(shape: tuple[int, int]) -> Float64Array:
    """Heights of the right-hand side's cosines, float64 array of this shape; nought for the mean."""
    return np.asarray(1.0 / eigenvalues(shape))
