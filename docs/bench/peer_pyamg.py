"""Peer: algebraic multigrid by pyamg, set up and solved; weights and holes included."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Literal

import numpy as np
from sparse_system import SparseSystem

from device.surface import Float32Array

TOLERANCE = 1e-5
"""Relative residual at which pyamg may stop: its error is then well under that of the noise."""

MOST_CYCLES = 60

Kind = Literal["ruge-stuben", "smoothed aggregation"]


def has_pyamg() -> bool:
    """Whether the package is installed."""
    return find_spec("pyamg") is not None


def solve_pyamg(system: SparseSystem, kind: Kind) -> Float32Array:
    """Heights (px) of shape (H, W), NaN at holes: conjugate gradients with one cycle as preconditioner."""
    import pyamg

    build = pyamg.ruge_stuben_solver if kind == "ruge-stuben" else pyamg.smoothed_aggregation_solver
    # One height is held at nought: of the singular matrix conjugate gradients say at large sizes that it is indefinite.
    solver = build(system.matrix[1:, 1:].tocsr())
    solution = np.zeros(len(system.rhs))
    solution[1:] = solver.solve(system.rhs[1:], tol=TOLERANCE, maxiter=MOST_CYCLES, accel="cg")
    return system.heights(solution)
