"""Blur of a lens from its f-number: diffraction, pixel and defocus in quadrature. Geometry and Airy's pattern alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from hal.profile_tables import LensConfig
from hal.simulator.arrays import Float32Array, FloatArray

WAVELENGTH_UM: Final = 0.53
GEL_INDEX: Final = 1.41
SIGMA_OF_DISC: Final = 0.25
"""Standard deviation along one axis of an evenly lit disc, as a share of its diameter."""

SIGMA_OF_AIRY: Final = 0.42
"""Of the Gaussian that fits the core of Airy's pattern, as a share of wavelength times f-number."""

SIGMA_OF_PIXEL: Final = 1.0 / math.sqrt(12.0)
FULL_WIDTH: Final = 2.3548
"""Full width at half height of a Gaussian, in standard deviations."""

LEVEL_RATIO: Final = 1.15
"""Blurs of neighbouring levels differ by this factor; between two, light is interpolated."""


@dataclass(frozen=True, slots=True)
class Blur:
    """Blur at the skin, µm.

    airy_um : diameter of Airy's disc
    pitch_um : pixel pitch
    defocus : diameter of the disc of defocus over the distance from the plane in focus
    depth_mm : distance from that plane at which the disc of defocus is as wide as two pixels
    focus_mm : height of that plane above the untouched skin
    """

    airy_um: float
    pitch_um: float
    defocus: float
    depth_mm: float
    focus_mm: float

    def at_um(self, off_mm: float) -> float:
        """Full width at half height at this distance from the plane in focus, mm."""
        return FULL_WIDTH * float(self.sigma_um(np.float64(off_mm)))

    def sigma_um(self, off_mm: FloatArray | np.float64) -> FloatArray:
        """Standard deviation of a point's image at these distances (mm) from the plane in focus; same shape."""
        fixed = math.hypot(SIGMA_OF_AIRY / 2.44 * self.airy_um, SIGMA_OF_PIXEL * self.pitch_um)
        return np.asarray(np.hypot(fixed, SIGMA_OF_DISC * self.defocus * 1e3 * off_mm))

    def spread(self, light: Float32Array, height_mm: FloatArray) -> Float32Array:
        """Light of shape (H, W) as blurred where the skin stands at `height_mm`, array of the same shape.

        Gaussians of a few levels are computed, and each pixel takes a mean of the two next to its own variance.
        """
        sigma_px = np.asarray(self.sigma_um(height_mm - self.focus_mm) / self.pitch_um, np.float32)
        low, high = float(sigma_px.min()), float(sigma_px.max())
        steps = max(math.ceil(math.log(high / low) / math.log(LEVEL_RATIO)), 1)
        levels = np.geomspace(low, high, steps + 1) if high > 1.001 * low else np.array([high])
        spread = np.zeros_like(light)
        for number, level in enumerate(levels):
            weight = _tent(sigma_px**2, levels**2, number)
            spread += weight * cv2.GaussianBlur(light, (0, 0), float(level), borderType=cv2.BORDER_REPLICATE)
        return spread


def blur_of(lens: LensConfig, pitch_um: float) -> Blur:
    """The blur of a lens at the f-number to which it is set."""
    magnification = lens.pixel_um / pitch_um
    airy_um = 2.44 * WAVELENGTH_UM * lens.f_number * (1.0 + magnification) / magnification
    # The pupil, focal length over f-number, stands f (1 + 1/m) from the skin; the gel narrows the cone.
    defocus = magnification / ((1.0 + magnification) * lens.f_number) / GEL_INDEX
    return Blur(airy_um, pitch_um, defocus, 2.0 * pitch_um * 1e-3 / defocus, lens.focus_mm)


def _tent(value: Float32Array, nodes: FloatArray, number: int) -> Float32Array:
    """Weight of one node in the linear interpolation between nodes: array of the shape of `value`, 0 to 1."""
    peak = np.zeros(nodes.size)
    peak[number] = 1.0
    return np.asarray(np.interp(value, nodes, peak), np.float32)
