"""Peer: algebraic multigrid by pyamg, set-up and solution, with weights and holes."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Literal

import numpy as np

from device.surface import Float32Array
from tests.benchmarks.speed.sparse_system import SparseSystem

TOLERANCE = 1e-5
"""Relative residual at which pyamg stops: its error is then well below that of the noise."""

MAX_CYCLES = 60

Kind = Literal["ruge-stuben", "smoothed aggregation"]


def has_pyamg() -> bool:
    """Whether the package is installed."""
    return find_spec("pyamg") is not None


def solve_pyamg(system: SparseSystem, kind: Kind) -> Float32Array:
    """Heights (px) of shape (H, W), NaN at holes: conjugate gradients with one cycle as preconditioner."""
    import pyamg

    build = pyamg.ruge_stuben_solver if kind == "ruge-stuben" else pyamg.smoothed_aggregation_solver
    # One height is fixed at zero: at large sizes conjugate gradients report the singular matrix as indefinite.
    solver = build(system.matrix[1:, 1:].tocsr())
    solution = np.zeros(len(system.rhs))
    solution[1:] = solver.solve(system.rhs[1:], tol=TOLERANCE, maxiter=MAX_CYCLES, accel="cg")
    return system.heights(solution)
