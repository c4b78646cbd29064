"""Least-squares sphere of a surface (Gaussian associated sphere).

The linear algebraic fit is the start; Gauss-Newton then minimises the squared distances. Each step is one compiled
pass, because the fit runs over every pixel of the field and of every sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.errors import MeasurementError
from host_sync.kernels.jit import njit
from host_sync.measurement.geometry import MIN_SHARE, SkinPlaces

MAX_STEPS: Final = 40
ENOUGH: Final = 1e-9
"""Step, as a fraction of the radius, that ends the iteration."""

MAX_RADIUS_RATIO: Final = 1e4
"""A radius of more than this many field widths counts as a plane."""


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere, lengths in µm; column and row of the centre from the centre of the first pixel.

    radius_um : positive for a bulge, negative for a hollow
    residual_um : RMS distance of the pixels from it
    """

    column_um: float
    row_um: float
    height_um: float
    radius_um: float
    residual_um: float


class SphereForm:
    """Subtracts the least-squares sphere from a surface, along the height.

    Parameters
    ----------
    places : of its pixels
    """

    def __init__(self, places: SkinPlaces) -> None:
        self._places = places
        self._last: Sphere | None = None
        self._beside: MaskArray | None = None

    def remove(self, z_um: Float32Array) -> Float32Array:
        """Return heights above the sphere: float32 array of shape (H, W), NaN where invalid or beside the sphere.

        Pixels beside the first surface's sphere stay invalid in later ones, so that a surface and its samples are
        compared on the same pixels.
        """
        self._last = sphere = fit_sphere(z_um, self._places, self._last)
        across_um, down_um = self._places.at(z_um)
        reach = sphere.radius_um**2 - (across_um - sphere.column_um) ** 2 - (down_um - sphere.row_um) ** 2
        if self._beside is None:
            self._beside = reach <= 0.0
        cap = np.sqrt(np.maximum(reach, 0.0))
        left = z_um - (sphere.height_um + np.sign(sphere.radius_um) * cap)
        return np.where(self._beside, np.nan, left).astype(np.float32)


def fit_sphere(z_um: Float32Array, places: SkinPlaces, start: Sphere | None = None) -> Sphere:
    """Return the least-squares sphere of the valid pixels of a surface.

    places : of its pixels
    start : a sphere close to it, if known

    Raises
    ------
    MeasurementError
        There are fewer than four valid pixels, or they show no curvature.
    """
    valid = np.isfinite(z_um)
    if valid.sum() < 4:
        raise MeasurementError(f"a sphere needs four valid pixels, found {int(valid.sum())}: widen the region")
    width_um = places.pitch_um * max(z_um.shape)
    middle = start or _algebraic(z_um, valid, places.pitch_um)
    grid = np.array([places.pitch_um, *places.middle_um, places.nearness_per_um, *places.level, MIN_SHARE])
    state = np.array([middle.column_um, middle.row_um, middle.height_um, abs(middle.radius_um)])
    for _ in range(MAX_STEPS):
        normal, right, _ = _step(z_um, grid, state)
        try:
            change = np.linalg.solve(normal, right)
        except np.linalg.LinAlgError:
            break
        state = state + change
        if not np.isfinite(state).all() or state[3] > MAX_RADIUS_RATIO * width_um:
            break
        if np.abs(change).max() < ENOUGH * state[3]:
            _, _, square = _step(z_um, grid, state)
            side = 1.0 if np.median(z_um[valid]) > state[2] else -1.0
            column, row, height, radius = (float(value) for value in state)
            return Sphere(column, row, height, side * radius, float(np.sqrt(square / valid.sum())))
    raise MeasurementError("the surface shows no sphere: it is too flat, or the region holds something else")


def _algebraic(z_um: Float32Array, valid: MaskArray, pitch_um: float) -> Sphere:
    """Return the sphere of the linear fit x² + y² + z² = 2 a x + 2 b y + 2 c z + d."""
    row, column = (index * pitch_um for index in np.nonzero(valid))
    step = max(1, row.size // 200_000)
    places: Float64Array = np.stack([column, row, z_um[valid].astype(np.float64), np.ones(row.size)], axis=-1)[::step]
    middle = places.mean(axis=0)
    middle[3] = 0.0
    places = places - middle
    scale = max(float(np.abs(places[:, :3]).max()), 1e-30)
    places[:, :3] /= scale
    square = (places[:, :3] ** 2).sum(axis=1)
    a, b, c, d = np.linalg.lstsq(places, square, rcond=None)[0]
    column_um, row_um, height_um = 0.5 * scale * np.array([a, b, c]) + middle[:3]
    radius_um = scale * float(np.sqrt(max(d + 0.25 * (a * a + b * b + c * c), 1e-30)))
    return Sphere(float(column_um), float(row_um), float(height_um), radius_um, 0.0)


@njit(cache=True)
def _step(z_um: Any, grid: Any, state: Any) -> tuple[Float64Array, Float64Array, float]:
    """Return the normal equations of one Gauss-Newton step, and the sum of squared distances."""
    rows, columns = z_um.shape
    normal, right, square = np.zeros((4, 4)), np.zeros(4), 0.0
    gradient = np.empty(4)
    gradient[3] = -1.0
    pitch_um, across_um, down_um, nearness, zero, across, down, least = grid
    for r in range(rows):
        for c in range(columns):
            z = z_um[r, c]
            if not np.isfinite(z):
                continue
            x, y = c * pitch_um - across_um, r * pitch_um - down_um
            share = max(1.0 - nearness * (z + zero + across * x + down * y), least)
            x, y = across_um + x * share - state[0], down_um + y * share - state[1]
            h = z - state[2]
            distance = max(np.sqrt(x * x + y * y + h * h), 1e-12)  # a centre on a pixel has no direction
            gradient[0], gradient[1], gradient[2] = -x / distance, -y / distance, -h / distance
            off = distance - state[3]
            square += off * off
            for i in range(4):
                right[i] -= gradient[i] * off
                for j in range(4):
                    normal[i, j] += gradient[i] * gradient[j]
    return normal, right, square
