"""Peer: scipy's sparse direct solver (SuperLU). Exact, with weights and holes, at sizes that it can solve."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import splu

from device.surface import Float32Array
from tests.benchmarks.speed.sparse_system import SparseSystem


def solve_direct(system: SparseSystem) -> Float32Array:
    """Heights (px) of shape (H, W), mean zero, NaN at holes; one unknown is fixed at zero."""
    solution = np.zeros(len(system.rhs))
    factors = splu(system.matrix[1:, 1:].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    solution[1:] = factors.solve(system.rhs[1:])
    return system.heights(solution)
