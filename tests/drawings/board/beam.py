"""Light of one light of the housing over the field of flat skin: LED's lobe, sleeve's bore, facet. A trace of rays.

The skin's plane is z = 0; block and gel are taken for one body, as their indices differ by 5 %. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.board_profile import BoardProfile

Floats = NDArray[np.float64]
ACRYLIC = 1.49
ENDLESS = 1000.0
"""A ratio beyond this is darkness."""


@dataclass(frozen=True, slots=True)
class Sleeve:
    """LEDs behind a facet.

    full_angle_deg : between the directions of half brightness of an LED
    offsets_mm : of each LED from the sleeve's axis, to the side
    behind_mm : from the facet back to an LED's front
    bore_mm : diameter of the opening in front of an LED
    """

    full_angle_deg: float
    offsets_mm: tuple[float, ...]
    behind_mm: float
    bore_mm: float


def light_over_field(
    position_mm: tuple[float, float, float],
    sleeve: Sleeve | float,
    half_field_mm: tuple[float, float],
    points: int = 21,
) -> Floats:
    """Irradiance of flat skin on a grid over the field, array of shape (points, points), the centre in its middle.

    sleeve : or the full angle (degrees) of LEDs that stand free in air and look at the skin's centre
    """
    x, y = np.meshgrid(*(np.linspace(-half, half, points) for half in half_field_mm))
    skin = np.stack([x, y, np.zeros_like(x)], axis=-1)
    distance = float(np.linalg.norm(position_mm))
    axis = -np.asarray(position_mm) / distance
    if not isinstance(sleeve, Sleeve):
        return _irradiance(skin, np.asarray(position_mm), axis, sleeve, refracting=False)
    side = np.cross(axis, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    total = np.zeros_like(x)
    for offset_mm in sleeve.offsets_mm:
        source = np.asarray(position_mm) + offset_mm * side
        lit = _irradiance(skin, source, axis, sleeve.full_angle_deg, refracting=True)
        sine = ACRYLIC * _sine(skin - source, axis)
        tangent = np.where(sine < 1.0, sine / np.sqrt(np.maximum(1.0 - sine**2, 1e-12)), np.inf)
        total += np.where(tangent * sleeve.behind_mm <= sleeve.bore_mm / 2.0, lit, 0.0)
    return total


def half_field_mm(profile: BoardProfile) -> tuple[float, float]:
    """Half the width and height of a board's field."""
    sensor = profile.sensor
    return sensor.columns * sensor.pixel_pitch_um / 2e3, sensor.rows * sensor.pixel_pitch_um / 2e3


def brightest_to_darkest(lit: Floats) -> float:
    """How many times as bright the field's brightest place is as its darkest."""
    return float(lit.max() / max(lit.min(), 1e-12))


def centre_to_darkest(lit: Floats) -> float:
    """How many times as bright the field's centre is as its darkest place."""
    return float(lit[lit.shape[0] // 2, lit.shape[1] // 2] / max(lit.min(), 1e-12))


def _irradiance(skin: Floats, source: Floats, axis: Floats, full_angle_deg: float, *, refracting: bool) -> Floats:
    away = skin - source
    squared = (away**2).sum(-1)
    sine = _sine(away, axis)
    # Nothing beyond the critical angle comes out of air.
    if refracting:
        outside = np.minimum(ACRYLIC * sine, 1.0)
        passed = _passed(outside, sine)
    else:
        outside, passed = sine, np.ones_like(sine)
    exponent = np.log(0.5) / np.log(np.cos(np.radians(full_angle_deg / 2.0)))  # 1 for 120 degrees: Lambert's law
    lobe = np.sqrt(1.0 - outside**2) ** exponent
    return np.asarray(lobe * passed * source[2] / squared**1.5, np.float64)


def _sine(away: Floats, axis: Floats) -> Floats:
    """Sine of the angle between directions and the axis."""
    cosine = (away @ axis) / np.sqrt((away**2).sum(-1))
    return np.asarray(np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), np.float64)


def _passed(outside: Floats, inside: Floats) -> Floats:
    """Fraction of unpolarised light that enters the facet, from the sines of its angles to the normal (Fresnel)."""
    cos_out, cos_in = np.sqrt(1.0 - outside**2), np.sqrt(1.0 - inside**2)
    across = (cos_out - ACRYLIC * cos_in) / (cos_out + ACRYLIC * cos_in)
    along = (ACRYLIC * cos_out - cos_in) / (ACRYLIC * cos_out + cos_in)
    return np.asarray(1.0 - (across**2 + along**2) / 2.0, np.float64)
