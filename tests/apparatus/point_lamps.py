"""Three point lamps over a matt skin, as a model that tests change."""

from __future__ import annotations

import numpy as np

from host_sync.lights.lamp_model import LampModel

POSITION = np.array([[0.7, 0.1, 0.5], [-0.4, 0.6, 0.4], [-0.3, -0.65, 0.45]])
"""By channel right, down and up from the middle of the field, in widths of it."""


def point_lamps(shape: tuple[int, int], position: np.ndarray = POSITION) -> LampModel:
    """Lamps at these places over a field of `shape` (H, W); light falls off with the square of the distance."""
    return LampModel(
        shape=shape,
        position=position,
        strip=0.0,
        fall_off=2.0,
        mixing=np.eye(3),
        haze=np.zeros(3),
        roughness=0.0,
        gloss=0.0,
        gloss_width=0.3,
        tilt_gain=0.0,
        bounce_close=0.0,
        bounce_afar=0.0,
        beam=0.0,
        tail=2.0,
        camera=0.0,
    )
