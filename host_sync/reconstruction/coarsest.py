"""Direct solution on the coarsest level by the pseudo-inverse of its graph Laplacian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array
from host_sync.reconstruction.grid_level import GridLevel, edge_weights

LOOSE = 1e-10
"""Eigenvalue of D^-½ A D^-½ below which a mode is the free level of an island."""


def pseudo_inverse(level: GridLevel) -> NDArray[np.float64]:
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
    """Write a small level's right-hand side: what its edges' weighted slopes bring in less what they take out."""
    across, down = edge_weights(level)
    level.rhs[:] = -np.diff(across * level.slope_across, axis=1) - np.diff(down * level.slope_down, axis=0)


def solve_coarsest(level: GridLevel, inverse: NDArray[np.float64]) -> None:
    """Write the level's heights from its right-hand side."""
    z: Float32Array = (inverse @ level.rhs.ravel().astype(np.float64)).astype(np.float32)
    level.z[:] = z.reshape(level.shape)
