"""Integration: ours and its peers on the same field, each with its error against the surface that made the field."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import peer_dct
from fields import KnownField, holed_field, plain_field
from floor import read_slopes_write_heights
from peer_cv2 import integrate_cv2
from peer_direct import solve_direct
from peer_pyamg import has_pyamg, solve_pyamg
from plan import Plan
from sparse_system import sparse_system
from timing import side_by_side

from device.surface import Float32Array
from host_sync.reconstruction.edge_slopes import EdgeRule
from host_sync.reconstruction.multigrid import Integrator, integrate

EXACT_TOLERANCE_PX = 1e-6
Solver = Callable[[], Float32Array]


def measure(plan: Plan, tell: Callable[[str], None]) -> dict[str, Any]:
    """Every figure of integration."""
    tell("integration: full rectangle")
    figures = {"unweighted": _unweighted(plain_field(plan.large), plan.rounds)}
    tell("integration: weights and holes")
    figures["weighted"] = _weighted(holed_field(plan.large), plan.rounds)
    tell("integration: algebraic multigrid beside ours")
    figures["beside pyamg"] = _beside_pyamg(holed_field(plan.small), plan.rounds)
    tell("integration: sparse direct solver beside ours")
    figures["beside direct"] = _beside_direct(holed_field(plan.direct), plan.rounds)
    figures["unweighted, small"] = _small(plain_field(plan.small), plan.rounds)
    return figures


def ours(field: KnownField, edges: EdgeRule = "fourth-order") -> Float32Array:
    """Our heights (px), at the tolerance that users get."""
    height, _ = integrate(field.gradients, 1.0, edges=edges)
    return height.z_um


def kept(field: KnownField) -> Solver:
    """The same by a solver that keeps its working arrays, as a sequence of frames uses it."""
    solver, out = Integrator(field.gradients.p.shape), np.empty_like(field.gradients.p)
    return lambda: solver.integrate(field.gradients, 1.0, out=out)[0].z_um


def peer(p: Float32Array, q: Float32Array, workers: int) -> Solver:
    """scipy's transform, which keeps its working arrays too."""
    kept_dct = peer_dct.KeptDct(p.shape, workers)
    return lambda: kept_dct.integrate(p, q)


def converged(field: KnownField, edges: EdgeRule = "fourth-order") -> Float32Array:
    """The same run until next to nothing is left of the algebraic error: `_beside_direct` proves it."""
    height, _ = integrate(field.gradients, 1.0, edges=edges, tolerance_px=EXACT_TOLERANCE_PX)
    return height.z_um


def _unweighted(field: KnownField, rounds: int) -> dict[str, Any]:
    p, q = field.gradients.p, field.gradients.q
    methods: dict[str, Solver] = {
        "floor": lambda: _floor(p, q),
        "ours": kept(field),
        "ours, fresh memory": lambda: ours(field),
        "ours, two-point": lambda: ours(field, "two-point"),
        "ours, printed differences": lambda: ours(field, "printed"),
        "scipy dctn, 1 worker": peer(p, q, 1),
        "scipy dctn, 2 workers": peer(p, q, 2),
        "cv2.dct": lambda: integrate_cv2(p, q),
    }
    figures = side_by_side(methods, rounds)
    for name, method in methods.items():
        figures[name]["rmse_px"] = None if name == "floor" else field.rmse_px(method())
    for name, fourth_order in (("exact", True), ("exact, two-point", False)):
        z = peer_dct.exact(p, q, fourth_order=fourth_order)
        figures[name] = {"rmse_px": field.rmse_px(z)}
    return figures


def _weighted(field: KnownField, rounds: int) -> dict[str, Any]:
    p, q = field.gradients.p * field.gradients.valid, field.gradients.q * field.gradients.valid
    methods: dict[str, Solver] = {
        "ours": kept(field),
        "scipy dctn, 2 workers": peer(p, q, 2),
    }
    figures = side_by_side(methods, rounds)
    for name, method in methods.items():
        figures[name]["rmse_px"] = field.rmse_px(method())
    figures["exact"] = {"rmse_px": field.rmse_px(converged(field))}
    return figures


def _beside_pyamg(field: KnownField, rounds: int) -> dict[str, Any]:
    methods: dict[str, Solver] = {"ours": lambda: ours(field), "ours, two-point": lambda: ours(field, "two-point")}
    slow: frozenset[str] = frozenset()
    if has_pyamg():
        system = sparse_system(field.gradients)
        methods["pyamg ruge-stuben"] = lambda: solve_pyamg(system, "ruge-stuben")
        methods["pyamg smoothed aggregation"] = lambda: solve_pyamg(system, "smoothed aggregation")
        slow = frozenset(name for name in methods if name.startswith("pyamg"))
    found: dict[str, Float32Array] = {}

    def kept(name: str, method: Solver) -> Callable[[], None]:
        return lambda: found.update({name: method()})

    figures = side_by_side({name: kept(name, method) for name, method in methods.items()}, rounds, once=slow)
    for name in methods:
        figures[name]["rmse_px"] = field.rmse_px(found[name])
    figures["exact"] = {"rmse_px": field.rmse_px(converged(field, "two-point"))}
    return figures


def _beside_direct(field: KnownField, rounds: int) -> dict[str, Any]:
    """The direct solution is the oracle: how far ours, run to a tiny residual, is from it at most."""
    system = sparse_system(field.gradients)
    figures = side_by_side({"ours": lambda: ours(field, "two-point")}, rounds)
    figures |= side_by_side({"scipy splu": lambda: solve_direct(system)}, rounds, once=frozenset({"scipy splu"}))
    direct = solve_direct(system)
    difference = (converged(field, "two-point") - direct)[system.used].astype(np.float64)
    figures["difference"] = {"largest_px": float(np.abs(difference - difference.mean()).max())}
    for name, z in (("ours", ours(field, "two-point")), ("scipy splu", direct)):
        figures[name]["rmse_px"] = field.rmse_px(z)
    return figures


def _small(field: KnownField, rounds: int) -> dict[str, Any]:
    p, q = field.gradients.p, field.gradients.q
    return side_by_side({"floor": lambda: _floor(p, q), "ours": lambda: ours(field)}, rounds)


def _floor(p: Float32Array, q: Float32Array) -> Float32Array:
    z = np.empty_like(p)
    read_slopes_write_heights(p, q, z)
    return z
