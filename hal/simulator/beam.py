"""Light of LEDs behind a block's facet, or free in air: lobe, bore and refraction at the facet.

Block and gel are taken for one body, as their indices differ by 5 %. Lengths in mm.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hal.optics_tables import BeamConfig
from hal.simulator.arrays import FloatArray

ACRYLIC: Final = 1.49
"""Refractive index of the block."""

Place = tuple[float, float, float]


def led_places_mm(position_mm: Place, beam: BeamConfig) -> tuple[Place, ...]:
    """Place of each LED of the light at `position_mm`: side by side, level and square to its axis."""
    axis = _axis(position_mm, beam)
    side = np.cross(axis, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    places = (np.asarray(position_mm) + offset_mm * side for offset_mm in beam.led_offsets_mm)
    return tuple((float(x), float(y), float(z)) for x, y, z in places)


def beam_fraction(
    point_mm: tuple[FloatArray, FloatArray, FloatArray], led_mm: Place, position_mm: Place, beam: BeamConfig
) -> FloatArray:
    """Intensity of an LED towards points of the skin, relative to that of a bare one on its axis.

    Parameters
    ----------
    point_mm : x, y and z of the points, arrays that broadcast to (H, W)
    led_mm : the LED's place
    position_mm : the light's position, which gives the axis

    Returns
    -------
    array of shape (H, W), 0 where the bore or total reflection leaves nothing
    """
    axis = _axis(position_mm, beam)
    away = [here - at for here, at in zip(point_mm, led_mm, strict=True)]
    distance = np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
    cosine = (away[0] * axis[0] + away[1] * axis[1] + away[2] * axis[2]) / distance
    inside = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    exponent = np.log(0.5) / np.log(np.cos(np.radians(beam.led_angle_deg / 2.0)))  # 1 for 120 degrees: Lambert's law
    if not beam.facet:
        return np.asarray(np.maximum(cosine, 0.0) ** exponent)
    # Nothing beyond the critical angle comes out of air.
    sine = ACRYLIC * inside
    outside = np.minimum(sine, 1.0)
    lobe = np.sqrt(1.0 - outside**2) ** exponent
    tangent = np.where(sine < 1.0, sine / np.sqrt(np.maximum(1.0 - sine**2, 1e-12)), np.inf)
    open_there = (tangent * beam.behind_mm <= beam.bore_mm / 2.0) & (cosine > 0.0)
    return np.where(open_there, lobe * _passed(outside, inside), 0.0)


def _axis(position_mm: Place, beam: BeamConfig) -> FloatArray:
    """Unit vector along which the light's LEDs look."""
    level = np.asarray((-position_mm[0], -position_mm[1], 0.0))
    across = float(np.linalg.norm(level))
    past = level * (beam.aim_past_mm / across) if across > 0.0 else level
    towards = past - np.asarray(position_mm)
    return np.asarray(towards / np.linalg.norm(towards))


def _passed(outside: FloatArray, inside: FloatArray) -> FloatArray:
    """Fraction of unpolarised light that enters the facet, from the sines of its angles to the normal (Fresnel)."""
    cos_out, cos_in = np.sqrt(1.0 - outside**2), np.sqrt(1.0 - inside**2)
    across = (cos_out - ACRYLIC * cos_in) / (cos_out + ACRYLIC * cos_in)
    along = (ACRYLIC * cos_out - cos_in) / (ACRYLIC * cos_out + cos_in)
    return np.asarray(1.0 - (across**2 + along**2) / 2.0)
