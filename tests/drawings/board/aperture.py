"""Blur at the skin from the lens's f-number: diffraction, defocus and the pixel. Geometry and Airy's pattern alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hal.board_profile import load_board_profile

PIXELS = {"pi5-imx296": 3.45, "pi4-imx477-binned": 2 * 1.55, "pi4-imx477": 1.55}
"""Pixels of the sensors of the boards with a lens to choose, um; makers' data."""

WAVELENGTH_UM = 0.53
GEL_INDEX = 1.41
SIGMA_OF_DISC = 0.25
"""Standard deviation along one axis of an evenly lit disc, as a share of its diameter."""

SIGMA_OF_AIRY = 0.42
"""Of the Gaussian that fits the core of Airy's pattern, as a share of wavelength times f-number."""

SIGMA_OF_PIXEL = 1.0 / math.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class Blur:
    """Blur of one board at one f-number, um at the skin.

    airy_um : diameter of Airy's disc
    defocus : diameter of the disc of defocus over the depth, both at the skin
    depth_mm : out of focus by this much, the disc of defocus is as wide as two pixels
    """

    airy_um: float
    pitch_um: float
    defocus: float
    depth_mm: float

    def at_um(self, depth_mm: float) -> float:
        """Full width at half height at this distance from the plane in focus, mm: all three in quadrature."""
        parts = (
            SIGMA_OF_AIRY / 2.44 * self.airy_um,
            SIGMA_OF_DISC * self.defocus * depth_mm * 1e3,
            SIGMA_OF_PIXEL * self.pitch_um,
        )
        return 2.3548 * math.hypot(*parts)


def blur(board: str, f_number: float) -> Blur:
    """The blur of a board with the lens at an f-number, as engraved on it (for far objects)."""
    pitch_um = load_board_profile(board).sensor.pixel_pitch_um
    magnification = PIXELS[board] / pitch_um
    airy_um = 2.44 * WAVELENGTH_UM * f_number * (1.0 + magnification) / magnification
    # The pupil, focal length over f-number, stands f (1 + 1/m) from the skin; the gel narrows the cone.
    defocus = magnification / ((1.0 + magnification) * f_number) / GEL_INDEX
    return Blur(airy_um, pitch_um, defocus, 2.0 * pitch_um * 1e-3 / defocus)
