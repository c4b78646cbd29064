"""Effect of elevation, spacing, distance and paint on slope range and gain: tables for board/light-geometry.md.

Every figure comes from the twin's own physics of light on the skin (`hal.simulator.scene`), for single points of the
skin with any slope. Slope noise is the bound set by photon and read noise (Cramér-Rao): three intensities, two
unknowns, each channel exposed so that its brightest pixel on slopes up to 40 degrees reaches 90 % of the full well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hal.simulator.lens import Lens
from hal.simulator.scene import SkinGeometry, coat, radiance

FULL_WELL_E: Final = 10_000.0
READ_NOISE_E: Final = 3.0
BRIGHTEST: Final = 0.9
STEP: Final = 0.01
HALF_FIELD_MM: Final = (8.7, 6.5)
AZIMUTHS: Final = np.radians(np.arange(0.0, 360.0, 10.0))
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Geometry:
    """Three lights: azimuth, height and distance (mm) of each, and the paint of the skin."""

    elevation_deg: float = 30.0
    distance_mm: float = 25.0
    azimuths_deg: tuple[float, float, float] = (-90.0, 30.0, 150.0)
    skin: str = "diffuse"

    def position_mm(self, light: int) -> tuple[float, float, float]:
        """Position of a light in the skin frame, mm."""
        up, around = np.radians(self.elevation_deg), np.radians(self.azimuths_deg[light])
        across = self.distance_mm * np.cos(up)
        return float(across * np.cos(around)), float(across * np.sin(around)), float(self.distance_mm * np.sin(up))


def light_on(geometry: Geometry, p: Floats, q: Floats, at_mm: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Radiance under each light of one point with these slopes, array of shape (3, ...)."""
    shape = (1, np.size(p))
    flat_p, flat_q = np.reshape(p, shape), np.reshape(q, shape)
    up = 1.0 / np.sqrt(1.0 + flat_p**2 + flat_q**2)
    arrays = (np.full(shape, at_mm[0]), np.full(shape, at_mm[1]), np.zeros(shape), -flat_p * up, -flat_q * up, up)
    skin = SkinGeometry(*(np.asarray(array, np.float32) for array in arrays))
    lens = Lens(np.zeros((1, shape[1]), np.float32), np.zeros((1, 1), np.float32), 1e-3, 160.0, 0.0, 0.0, 0.0)
    lit = [radiance(skin, lens, coat(geometry.skin), geometry.position_mm(light), 1.0) for light in range(3)]
    return np.asarray(lit, np.float64).reshape(3, *np.shape(p))


def electrons(geometry: Geometry, p: Floats, q: Floats) -> Floats:
    """Electrons collected by a pixel in each channel, as exposed."""
    tilts = np.tan(np.radians(np.linspace(0.0, 40.0, 41)))
    steepest = light_on(geometry, np.outer(tilts, np.cos(AZIMUTHS)), np.outer(tilts, np.sin(AZIMUTHS)))
    scale = BRIGHTEST * FULL_WELL_E / steepest.reshape(3, -1).max(axis=1)
    return np.asarray(light_on(geometry, p, q) * scale.reshape(3, *([1] * np.ndim(p))))


def slope_noise(geometry: Geometry, tilt_deg: float) -> Floats:
    """Standard error of a slope at one tilt in every direction, array of shape (36,); infinite where undetermined."""
    tilt = np.tan(np.radians(tilt_deg))
    p, q = tilt * np.cos(AZIMUTHS), tilt * np.sin(AZIMUTHS)
    here = electrons(geometry, p, q)
    dp = (electrons(geometry, p + STEP, q) - electrons(geometry, p - STEP, q)) / (2 * STEP)
    dq = (electrons(geometry, p, q + STEP) - electrons(geometry, p, q - STEP)) / (2 * STEP)
    weight = 1.0 / (here + READ_NOISE_E**2)
    pp, qq, pq = (weight * dp**2).sum(0), (weight * dq**2).sum(0), (weight * dp * dq).sum(0)
    determinant = pp * qq - pq**2
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(determinant > 1e-6 * (pp + qq) ** 2, np.sqrt((pp + qq) / (2 * determinant)), np.inf)


def gain(geometry: Geometry) -> float:
    """Relative change of a channel per unit slope towards its light, on flat skin."""
    away = np.radians(geometry.azimuths_deg[0])
    steps = STEP * np.array([-1.0, 0.0, 1.0])
    low, here, high = light_on(geometry, steps * np.cos(away), steps * np.sin(away))[0]
    return float(abs(high - low) / (2 * STEP * here))


def all_lit_deg(geometry: Geometry, at_mm: tuple[float, float] = (0.0, 0.0)) -> float:
    """Largest tilt at which every light reaches the skin in any direction, degrees."""
    tilts = np.arange(0.5, 89.5, 0.5)
    slopes = np.tan(np.radians(tilts))
    lit = light_on(geometry, np.outer(slopes, np.cos(AZIMUTHS)), np.outer(slopes, np.sin(AZIMUTHS)), at_mm)
    dark = lit.min(axis=(0, 2)) <= 0.0
    return float(tilts[dark.argmax()] - 0.5) if dark.any() else float(tilts[-1])


def unevenness(geometry: Geometry) -> float:
    """Brightest over darkest position of flat skin in the field, of the most uneven light."""
    zero = np.zeros(1)
    corners = [(x * HALF_FIELD_MM[0], y * HALF_FIELD_MM[1]) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    levels = np.stack([light_on(geometry, zero, zero, corner)[:, 0] for corner in corners])
    return float((levels.max(0) / levels.min(0)).max())


def worst_corner_deg(geometry: Geometry) -> float:
    """`all_lit_deg` at the corner of the field where it is least, degrees."""
    corners = [(x * HALF_FIELD_MM[0], y * HALF_FIELD_MM[1]) for x in (-1, 1) for y in (-1, 1)]
    return min(all_lit_deg(geometry, corner) for corner in corners)


def scale_error(geometry: Geometry, moved: Geometry, tilt_deg: float = 20.0) -> float:
    """Relative error of slopes when a light moved after calibration and its reference was taken again."""
    slope = np.tan(np.radians(tilt_deg)) * np.array([0.0, -1.0])
    away = np.radians(geometry.azimuths_deg[0])
    before, after = (light_on(g, slope * np.cos(away), slope * np.sin(away))[0] for g in (geometry, moved))
    change = after[1] / after[0] - before[1] / before[0]
    step = np.tan(np.radians(tilt_deg)) + STEP
    steeper = light_on(geometry, -step * np.cos(away) * np.ones(1), -step * np.sin(away) * np.ones(1))[0, 0] / before[0]
    return float(abs(change / ((steeper - before[1] / before[0]) / STEP)) / np.tan(np.radians(tilt_deg)))


def told_to_deg(geometry: Geometry) -> float:
    """Largest tilt at which slopes are determined in every direction with at most three times the noise of flat skin,
    degrees."""
    flat = slope_noise(geometry, 0.0).max()
    tilts = np.arange(2.0, 70.0, 1.0)
    lost = (tilt for tilt in tilts if slope_noise(geometry, tilt).max() > 3.0 * flat)
    return float(next(lost, tilts[-1] + 1.0) - 1.0)
