"""Light of one light of the housing over the field of flat skin, by the twin's beam.

The skin's plane is z = 0. Lengths in mm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.board_profile import BoardProfile
from hal.profile_tables import BeamConfig
from hal.simulator.scene import beam_fraction, led_places_mm

Floats = NDArray[np.float64]
ENDLESS = 1000.0
"""A ratio beyond this is darkness."""


def light_over_field(
    position_mm: tuple[float, float, float], beam: BeamConfig, half_field_mm: tuple[float, float], points: int = 21
) -> Floats:
    """Irradiance of flat skin on a grid over the field, array of shape (points, points), the centre in its middle."""
    x, y = np.meshgrid(*(np.linspace(-half, half, points) for half in half_field_mm))
    total = np.zeros_like(x)
    for led_mm in led_places_mm(position_mm, beam):
        squared = (x - led_mm[0]) ** 2 + (y - led_mm[1]) ** 2 + led_mm[2] ** 2
        fraction = beam_fraction((x, y, np.zeros_like(x)), led_mm, position_mm, beam)
        total += fraction * led_mm[2] / squared**1.5
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
