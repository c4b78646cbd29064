"""Peak memory of the integrators, each in its own process: what a solution needs besides its input."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.benchmarks.speed import integration, peer_dct
from tests.benchmarks.speed.fields import holed_field, plain_field
from tests.benchmarks.speed.fresh import forget_peak, fresh, peak_mb, resident_mb
from tests.benchmarks.speed.peer_cv2 import integrate_cv2
from tests.benchmarks.speed.peer_direct import solve_direct
from tests.benchmarks.speed.peer_pyamg import has_pyamg, solve_pyamg
from tests.benchmarks.speed.plan import Plan, Shape, named
from tests.benchmarks.speed.sparse_system import sparse_system


def measure(plan: Plan, report_progress: Callable[[str], None]) -> dict[str, Any]:
    """Size and peak (MB besides the field) by method."""
    cases = {"ours, weighted": plan.large}
    if not plan.quick:
        cases |= _peers(plan)
    report_progress("peak memory of the integrators")
    return {name: {"size": named(shape), "peak_mb": fresh(peak_of, name, shape)} for name, shape in cases.items()}


def _peers(plan: Plan) -> dict[str, Shape]:
    """Sizes of the peers, by method."""
    cases = {
        "ours, unweighted": plan.large,
        "scipy dctn, 2 workers": plan.large,
        "cv2.dct": plan.large,
        "scipy splu": plan.direct,
    }
    if has_pyamg():
        cases |= {"pyamg ruge-stuben": plan.small, "pyamg smoothed aggregation": plan.small}
    return cases


def peak_of(name: str, shape: Shape) -> float:
    """Largest resident memory while a method solves, minus that before, MB."""
    plain = name in {"ours, unweighted", "scipy dctn, 2 workers", "cv2.dct"}
    field = plain_field(shape) if plain else holed_field(shape)
    p, q = field.gradients.p, field.gradients.q
    methods: dict[str, Callable[[], Any]] = {
        "ours, unweighted": lambda: integration.ours(field),
        "ours, weighted": lambda: integration.ours(field),
        "scipy dctn, 2 workers": lambda: peer_dct.KeptDct(p.shape, 2).integrate(p, q),
        "cv2.dct": lambda: integrate_cv2(p, q),
        "scipy splu": lambda: solve_direct(sparse_system(field.gradients)),
        "pyamg ruge-stuben": lambda: solve_pyamg(sparse_system(field.gradients), "ruge-stuben"),
        "pyamg smoothed aggregation": lambda: solve_pyamg(sparse_system(field.gradients), "smoothed aggregation"),
    }
    if name.startswith("ours"):
        integration.ours(plain_field((64, 64)) if plain else holed_field((64, 64)))  # compiled code is not the solver's
    before = resident_mb()
    forget_peak()
    methods[name]()
    return peak_mb() - before
