"""The skin over a pressed object: an obstacle problem, solved by projected multigrid.

The slab is bonded to a rigid window on one side and covered by the skin on the other. With displacement that falls
linearly towards the window (Vlasov's foundation) and shear modulus E/3, the skin minimizes ∫ L²|∇z|² + z² with L =
thickness / 3, under z >= object. It touches where it is pushed, bridges narrow valleys, and leaves the object
tangentially.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.special import k0e, k1e

from hal.simulator.surfaces import Float32Array, FloatArray, MaskArray

MAX_COMPRESSION: Final = 0.6
"""Maximum compression, as a fraction of the slab's thickness."""

_NOTHING: Final = np.float32(-1e3)
_DAMPING: Final = 0.8
_CROSS: Final = np.array(((0.0, 1.0, 0.0), (1.0, 0.0, 1.0), (0.0, 1.0, 0.0)), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """The deformed skin.

    height_mm : float32 array of shape (H, W), mm above the untouched skin
    contact : bool array of shape (H, W), True where it touches the object
    """

    height_mm: Float32Array
    contact: MaskArray


def decay_length_mm(thickness_mm: float) -> float:
    """Return the distance (mm) over which a dent decays by a factor e."""
    return thickness_mm / 3.0


def ball_indentation_mm(radius_mm: float, slope_angle_rad: float, thickness_mm: float) -> float:
    """Return the indentation of a ball whose contact ends at the given slope.

    It is the height of the cap in contact plus the lift of the skin around it.
    """
    length = decay_length_mm(thickness_mm)
    rim = radius_mm * np.sin(slope_angle_rad) / length
    lift = np.tan(slope_angle_rad) * length * k0e(rim) / k1e(rim)
    return float(radius_mm * (1.0 - np.cos(slope_angle_rad)) + lift)


def drape(object_mm: FloatArray, pitch_mm: float, thickness_mm: float, cycles: int = 8) -> Skin:
    """Return the skin over an object of height `object_mm`, array of shape (H, W), mm, NaN outside the object."""
    obstacle = np.where(np.isfinite(object_mm), object_mm, _NOTHING).astype(np.float32)
    stiffness = (decay_length_mm(thickness_mm) / pitch_mm) ** 2
    height = _solve(obstacle, stiffness, cycles)
    return Skin(height, height <= obstacle)


def _solve(obstacle: Float32Array, stiffness: float, cycles: int) -> Float32Array:
    """Nested iteration: the coarser solution starts the finer one; float32 array of shape (H, W)."""
    if _is_coarsest(obstacle):
        height = np.maximum(obstacle, np.float32(0.0))
        for _ in range(400):
            height = _relax(height, stiffness, obstacle)
        return height
    height = _finer(_solve(_coarser(obstacle), stiffness / 4.0, cycles), obstacle)
    height = np.maximum(height, obstacle)
    for _ in range(cycles):
        height = _cycle(height, stiffness, obstacle)
    return height


def _cycle(height: Float32Array, stiffness: float, obstacle: Float32Array) -> Float32Array:
    """Return one V-cycle: the free skin is corrected from coarser grids, the contact changes by relaxation only."""
    for _ in range(2):
        height = _relax(height, stiffness, obstacle)
    free = (height > obstacle).astype(np.float32)
    residual = _residual(height, np.zeros_like(height), free, stiffness)
    correction = _correct(_coarser(residual), _coarser(free), stiffness / 4.0)
    height = np.maximum(height + free * _finer(correction, height), obstacle)
    for _ in range(2):
        height = _relax(height, stiffness, obstacle)
    return height


def _correct(residual: Float32Array, free_fraction: Float32Array, stiffness: float) -> Float32Array:
    """Solve (1 - stiffness Δ) e = residual in completely free cells, e = 0 elsewhere; float32, same shape."""
    free = (free_fraction > 0.999).astype(np.float32)
    residual = residual * free
    error = np.zeros_like(residual)
    coarsest = _is_coarsest(residual)
    for _ in range(60 if coarsest else 2):
        error = _relax_free(error, residual, free, stiffness)
    if coarsest:
        return error
    rest = _residual(error, residual, free, stiffness)
    error = error + free * _finer(_correct(_coarser(rest), _coarser(free), stiffness / 4.0), error)
    for _ in range(2):
        error = _relax_free(error, residual, free, stiffness)
    return error


def _residual(values: Float32Array, load: Float32Array, free: Float32Array, stiffness: float) -> Float32Array:
    """Return the residual of (1 - stiffness Δ) values = load in free cells; float32 array of the same shape."""
    bent = np.float32(stiffness) * (_neighbours(values) - np.float32(4.0) * values)
    return (load + bent - values) * free


def _relax(height: Float32Array, stiffness: float, obstacle: Float32Array) -> Float32Array:
    """Return one projected, damped Jacobi sweep."""
    factor = _DAMPING * stiffness / (1.0 + 4.0 * stiffness)
    moved = _neighbours(height)
    moved *= np.float32(factor)
    moved += np.float32(1.0 - _DAMPING) * height
    return np.maximum(moved, obstacle, out=moved)


def _relax_free(error: Float32Array, residual: Float32Array, free: Float32Array, stiffness: float) -> Float32Array:
    """Return one damped Jacobi sweep of the free cells."""
    factor = np.float32(_DAMPING / (1.0 + 4.0 * stiffness))
    moved = _neighbours(error)
    moved *= np.float32(stiffness)
    moved += residual
    moved *= factor
    moved += np.float32(1.0 - _DAMPING) * error
    moved *= free
    return moved


def _neighbours(values: Float32Array) -> Float32Array:
    """Return the sum of the four neighbours, without flux through the border."""
    summed = cv2.filter2D(values, -1, _CROSS, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(summed, np.float32)


def _is_coarsest(values: Float32Array) -> bool:
    rows, columns = values.shape
    return bool(min(rows, columns) < 16)


def _coarser(values: Float32Array) -> Float32Array:
    rows, columns = values.shape
    size = ((columns + 1) // 2, (rows + 1) // 2)
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)


def _finer(values: Float32Array, like: Float32Array) -> Float32Array:
    rows, columns = like.shape
    return np.asarray(cv2.resize(values, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)
