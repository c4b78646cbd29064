"""Peer: scipy's sparse direct solver (SuperLU). Exact, weights and holes included, at sizes that it can do."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import splu
from sparse_system import SparseSystem

from device.surface import Float32Array


def solve_direct(system: SparseSystem) -> Float32Array:
    """Heights (px) of shape (H, W), mean zero, NaN at holes; one unknown is held at nought to fix the level."""
    solution = np.zeros(len(system.rhs))
    factors = splu(system.matrix[1:, 1:].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    solution[1:] = factors.solve(system.rhs[1:])
    return system.heights(solution)
