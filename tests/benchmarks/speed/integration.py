"""Integration: ours and its peers on the same field, each with its error against the surface that made the field.

Accuracy of a method is measured as a distance. Its own error may by chance cancel or increase part of the effect of
noise on the exact least-squares solution; whether it is small beside that of noise is √(exact² + distance²) / exact,
with the distance between both solutions, worst of several fields.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array
from host_sync.integration.integrate import Integrator, integrate
from host_sync.integration.levels import EdgeRule
from tests.benchmarks.speed import peer_dct
from tests.benchmarks.speed.fields import KnownField, holed_field, plain_field
from tests.benchmarks.speed.floor import read_slopes_write_heights
from tests.benchmarks.speed.peer_cv2 import integrate_cv2
from tests.benchmarks.speed.peer_direct import solve_direct
from tests.benchmarks.speed.peer_pyamg import has_pyamg, solve_pyamg
from tests.benchmarks.speed.plan import Plan, Shape
from tests.benchmarks.speed.sparse_system import sparse_system
from tests.benchmarks.speed.timing import side_by_side

EXACT_TOLERANCE_PX = 1e-6
CONVERGED_TOLERANCE_PX = 1e-4
"""A hundredth of the noise error, and within reach of single precision at every size."""

MAX_CYCLES = 20
SEEDS = (0, 1, 2)
Solver = Callable[[], Float32Array]


def measure(plan: Plan, report_progress: Callable[[str], None]) -> dict[str, Any]:
    """All figures of integration."""
    report_progress("integration: full rectangle")
    figures = {"unweighted": _unweighted(plain_field(plan.large), plan.rounds)}
    figures["unweighted"]["accuracy"] = _worst([_plain_over_exact(plan.large, seed) for seed in SEEDS])
    report_progress("integration: weights and holes")
    figures["weighted"] = _weighted(holed_field(plan.large), plan.rounds)
    figures["weighted"]["accuracy"] = _worst([_holed_over_exact(plan.large, seed) for seed in SEEDS])
    report_progress("integration: algebraic multigrid beside ours")
    figures["beside pyamg"] = _beside_pyamg(holed_field(plan.small), plan.rounds)
    report_progress("integration: sparse direct solver beside ours")
    figures["beside direct"] = _beside_direct(holed_field(plan.direct), plan.rounds)
    figures["unweighted, small"] = _small(plain_field(plan.small), plan.rounds)
    return figures


def ours(field: KnownField, edges: EdgeRule = "fourth-order") -> Float32Array:
    """Our heights (px), at the default tolerance."""
    height, _ = integrate(field.gradients, 1.0, edges=edges)
    return height.z_um


def written_out(field: KnownField) -> KnownField:
    """The same field with weights written out, so that every one of them must be read."""
    shape = field.gradients.p.shape
    weights = {"valid": np.ones(shape, np.bool_), "weight": np.ones(shape, np.float32)}
    return replace(field, gradients=replace(field.gradients, **weights))


def persistent(field: KnownField, edges: EdgeRule = "fourth-order") -> Solver:
    """The same by a solver that keeps its working arrays, as for a sequence of frames."""
    solver, out = Integrator(field.gradients.p.shape), np.empty_like(field.gradients.p)
    return lambda: solver.integrate(field.gradients, 1.0, edges=edges, out=out)[0].z_um


def peer(p: Float32Array, q: Float32Array, workers: int) -> Solver:
    """scipy's transform, which keeps its working arrays too."""
    kept_dct = peer_dct.KeptDct(p.shape, workers)
    return lambda: kept_dct.integrate(p, q)


def transforms_alone(p: Float32Array, workers: int) -> Solver:
    """The part of the peer that runs on all threads: its transforms, whose time does not depend on the values."""
    kept_dct, rhs = peer_dct.KeptDct(p.shape, workers), np.zeros_like(p)
    return lambda: kept_dct.transforms(rhs)


def converged(
    field: KnownField, edges: EdgeRule = "fourth-order", tolerance_px: float = CONVERGED_TOLERANCE_PX
) -> Float32Array:
    """The same with negligible algebraic error; `_beside_direct` verifies it."""
    cycles = 200 if tolerance_px < CONVERGED_TOLERANCE_PX else MAX_CYCLES
    height, _ = integrate(field.gradients, 1.0, edges=edges, tolerance_px=tolerance_px, max_cycles=cycles)
    return height.z_um


def over_exact(field: KnownField, z: NDArray[Any], exact: NDArray[Any]) -> float:
    """Error of the exact solution combined with a method's distance to it, relative to the former; at least 1."""
    used = field.gradients.valid
    distance_px = float((z[used].astype(np.float64) - exact[used]).std())
    noise_px = field.rmse_px(exact)
    return float(np.hypot(noise_px, distance_px) / noise_px)


def _plain_over_exact(shape: Shape, seed: int) -> float:
    field = plain_field(shape, seed)
    exact = peer_dct.exact(field.gradients.p, field.gradients.q, fourth_order=True)
    return over_exact(field, ours(field), exact)


def _holed_over_exact(shape: Shape, seed: int) -> float:
    field = holed_field(shape, seed)
    return over_exact(field, ours(field), converged(field))


def _worst(found: list[float]) -> dict[str, Any]:
    return {"over_exact": max(found), "fields": len(found)}


def _unweighted(field: KnownField, rounds: int) -> dict[str, Any]:
    p, q = field.gradients.p, field.gradients.q
    methods: dict[str, Solver] = {
        "ours": persistent(field),
        "ours, weights written out": persistent(written_out(field)),
        "ours, fresh memory": lambda: ours(field),
        "ours, two-point": lambda: ours(field, "two-point"),
        "ours, printed differences": lambda: ours(field, "printed"),
        "scipy dctn, 1 worker": peer(p, q, 1),
        "scipy dctn, 2 workers": peer(p, q, 2),
        "scipy dctn, transforms alone": transforms_alone(p, 2),
        # Its threads wait busily for a while after it: what comes next is a peer that runs on one.
        "floor": lambda: _floor(p, q),
        "cv2.dct": lambda: integrate_cv2(p, q),
    }
    figures = side_by_side(methods, rounds)
    for name, method in methods.items():
        no_surface = name in ("floor", "scipy dctn, transforms alone")
        figures[name]["rmse_px"] = None if no_surface else field.rmse_px(method())
    for name, fourth_order in (("exact", True), ("exact, two-point", False)):
        z = peer_dct.exact(p, q, fourth_order=fourth_order)
        figures[name] = {"rmse_px": field.rmse_px(z)}
    return figures


def _weighted(field: KnownField, rounds: int) -> dict[str, Any]:
    p, q = field.gradients.p * field.gradients.valid, field.gradients.q * field.gradients.valid
    methods: dict[str, Solver] = {
        "ours": persistent(field),
        "scipy dctn, 2 workers": peer(p, q, 2),
    }
    figures = side_by_side(methods, rounds)
    for name, method in methods.items():
        figures[name]["rmse_px"] = field.rmse_px(method())
    figures["exact"] = {"rmse_px": field.rmse_px(converged(field))}
    return figures


def _beside_pyamg(field: KnownField, rounds: int) -> dict[str, Any]:
    methods: dict[str, Solver] = {
        "ours": persistent(field),
        "ours, two-point": persistent(field, "two-point"),
    }
    slow: frozenset[str] = frozenset()
    if has_pyamg():
        system = sparse_system(field.gradients)
        methods["pyamg ruge-stuben"] = lambda: solve_pyamg(system, "ruge-stuben")
        methods["pyamg smoothed aggregation"] = lambda: solve_pyamg(system, "smoothed aggregation")
        slow = frozenset(name for name in methods if name.startswith("pyamg"))
    found: dict[str, Float32Array] = {}

    def noting(name: str, method: Solver) -> Callable[[], None]:
        return lambda: found.update({name: method()})

    figures = side_by_side({name: noting(name, method) for name, method in methods.items()}, rounds, once=slow)
    exact = converged(field, "two-point")
    for name in methods:
        figures[name]["rmse_px"] = field.rmse_px(found[name])
        if name != "ours":
            figures[name]["over_exact"] = over_exact(field, found[name], exact)
    figures["exact"] = {"rmse_px": field.rmse_px(exact)}
    return figures


def _beside_direct(field: KnownField, rounds: int) -> dict[str, Any]:
    """Largest difference of our converged solution to the direct solution, the oracle."""
    system = sparse_system(field.gradients)
    figures = side_by_side({"ours": lambda: ours(field, "two-point")}, rounds)
    figures |= side_by_side({"scipy splu": lambda: solve_direct(system)}, rounds, once=frozenset({"scipy splu"}))
    direct = solve_direct(system)
    difference = (converged(field, "two-point", EXACT_TOLERANCE_PX) - direct)[system.used].astype(np.float64)
    figures["difference"] = {"largest_px": float(np.abs(difference - difference.mean()).max())}
    for name, z in (("ours", ours(field, "two-point")), ("scipy splu", direct)):
        figures[name]["rmse_px"] = field.rmse_px(z)
    return figures


def _small(field: KnownField, rounds: int) -> dict[str, Any]:
    p, q = field.gradients.p, field.gradients.q
    return side_by_side({"ours": persistent(field)}, rounds) | side_by_side({"floor": lambda: _floor(p, q)}, rounds)


def _floor(p: Float32Array, q: Float32Array) -> Float32Array:
    z = np.empty_like(p)
    read_slopes_write_heights(p, q, z)
    return z
