"""Conjugate gradients preconditioned by the V-cycle, for fields on which V-cycles alone converge slowly or not at all.

Labyrinths of holes, bridges one pixel wide and weights that jump by decades have parts that a coarse level cannot
separate. Conjugate gradients converge with any symmetric positive preconditioner; the V-cycle is nearly symmetric,
which the flexible (Polak-Ribière) form tolerates. Vectors are float64 because such fields are ill-conditioned too; the
preconditioner works in float32.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.integration.levels import GridLevel, edge_weights

WINDOW: Final = 8
"""Iterations over which the rate of convergence is measured."""

MIN_RATE: Final = 0.5
"""Smallest convergence rate used in the estimate: a part attached by one bridge appears late, after steps that fell
much faster."""

ROUNDING: Final = 4.0 * float(np.finfo(np.float32).eps)
"""Relative accuracy of heights from single-precision slopes. Steps below it gain nothing; far below it they follow
rounding errors and never end."""


@dataclass(frozen=True, slots=True, eq=False)
class KrylovSolution:
    """Heights (float32 array of shape (H, W)), residual of each iteration, estimated error, in the system's unit."""

    z: Float32Array
    residuals: tuple[float, ...]
    error: float


def conjugate_gradients(
    level: GridLevel,
    rhs: Float64Array,
    start: Float64Array,
    precondition: Callable[[], object],
    tolerance: float,
    max_cycles: int,
) -> KrylovSolution:
    """Return the solution of the level's system.

    rhs : float64 array of shape (H, W) whose sum over each component is zero; its unit is that of the heights
    start : float64 array of shape (H, W), initial heights; overwritten
    precondition : one V-cycle from zero for `level.rhs`; leaves its result in `level.z`
    """
    z = start
    residual = rhs - laplacian(level, z)
    direction, image, energy = np.zeros_like(z), np.zeros_like(z), 1.0
    steps: list[float] = []
    residuals: list[float] = []
    error, least = np.inf, 0.0
    while len(steps) < max_cycles and error > max(tolerance, least):
        size = _rms(residual)
        residuals.append(size)
        if size == 0.0:
            return KrylovSolution(z.astype(np.float32), tuple(residuals), 0.0)
        level.rhs[:] = residual / size
        precondition()
        correction = np.asarray(level.z * size, np.float64)
        direction *= -_inner(correction, image) / energy
        direction += correction
        image = laplacian(level, direction)
        energy = _inner(direction, image)
        if not energy > 0.0:
            break
        length = _inner(direction, residual) / energy
        z += length * direction
        residual -= length * image
        steps.append(abs(length) * _rms(direction))
        error, least = _remaining_error(steps), ROUNDING * _rms(z)
    return KrylovSolution(z.astype(np.float32), tuple(residuals), max(error, least))


def laplacian(level: GridLevel, z: Float64Array) -> Float64Array:
    """Σ w_e (z - z_neighbour), float64 array of shape (H, W), as differences of edge flows."""
    weight_x, weight_y = edge_weights(level)
    out = np.zeros_like(z)
    flow = np.diff(z, axis=1) * weight_x[:, 1:-1]
    out[:, 1:] += flow
    out[:, :-1] -= flow
    flow = np.diff(z, axis=0) * weight_y[1:-1]
    out[1:] += flow
    out[:-1] -= flow
    return out


def _inner(a: Float64Array, b: Float64Array) -> float:
    """Return the inner product; the order of summation does not depend on the number of threads."""
    return float((a * b).sum())


def _rms(values: Float64Array) -> float:
    return float(np.sqrt(np.square(values).mean()))


def _remaining_error(steps: list[float]) -> float:
    """Return the estimated error: sum of all later steps if they keep falling at the rate of the last window."""
    if len(steps) <= WINDOW:
        return float("inf")
    recent, before = max(steps[-WINDOW // 2 :]), max(steps[-WINDOW - 1 : -WINDOW // 2])
    rate = max((recent / before) ** (2.0 / (WINDOW + 1)) if before > 0.0 else 0.0, MIN_RATE)
    return recent * rate / (1.0 - rate) if rate < 1.0 else float("inf")
