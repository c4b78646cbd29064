"""Conjugate gradients around the V-cycle, for fields on which V-cycles alone converge slowly or not at all.

Labyrinths of holes, bridges one pixel wide and weights that jump by decades from pixel to pixel have parts that a
coarse level cannot tell apart. Conjugate gradients converge with any symmetric positive preconditioner; the V-cycle is
nearly symmetric, which the flexible (Polak-Ribière) form allows for. Vectors are float64, for such fields are
ill-conditioned too: only the preconditioner works in float32.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.reconstruction.grid_level import GridLevel, edge_weights

WINDOW: Final = 8
"""Iterations over which the rate of convergence is measured."""

LEAST_RATE: Final = 0.5
"""Least rate that is believed: a part that hangs by one bridge shows late, after steps that fell much faster."""

ROUNDING: Final = 4.0 * float(np.finfo(np.float32).eps)
"""Share of the heights that single precision of slopes and results leaves in doubt. Steps beyond it gain nothing, and
far beyond it follow rounding errors alone, without end."""


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
    """Solution of the level's system.

    rhs : float64 array of shape (H, W) whose sum over each island is nought; its unit is the heights'
    start : float64 array of shape (H, W), heights to begin with; overwritten
    precondition : one V-cycle from nought for `level.rhs`; leaves its result in `level.z`
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
    across, down = edge_weights(level)
    out = np.zeros_like(z)
    flow = np.diff(z, axis=1) * across[:, 1:-1]
    out[:, 1:] += flow
    out[:, :-1] -= flow
    flow = np.diff(z, axis=0) * down[1:-1]
    out[1:] += flow
    out[:-1] -= flow
    return out


def _inner(a: Float64Array, b: Float64Array) -> float:
    """Inner product, summed in one order whatever the number of threads."""
    return float((a * b).sum())


def _rms(values: Float64Array) -> float:
    return float(np.sqrt(np.square(values).mean()))


def _remaining_error(steps: list[float]) -> float:
    """Estimated error: what the steps of the last window would add up to if they went on as they fell."""
    if len(steps) <= WINDOW:
        return float("inf")
    recent, before = max(steps[-WINDOW // 2 :]), max(steps[-WINDOW - 1 : -WINDOW // 2])
    rate = max((recent / before) ** (2.0 / (WINDOW + 1)) if before > 0.0 else 0.0, LEAST_RATE)
    return recent * rate / (1.0 - rate) if rate < 1.0 else float("inf")
