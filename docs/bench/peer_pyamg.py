"""Peer: algebraic multigrid by pyamg, set up and solved; weights and holes included."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Literal

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
    solver = build(system.matrix)
    return system.heights(solver.solve(system.rhs, tol=TOLERANCE, maxiter=MOST_CYCLES, accel="cg"))
