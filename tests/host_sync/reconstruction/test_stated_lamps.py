"""Places of lights that a frame set or a board states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from near_lamps import RADIUS_PX, SHAPE, press_px

from device.balls.sphere import Ball
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import Calibration, calibrate
from host_sync.reconstruction.pipeline import reconstruct
from tests.apparatus.light_ring import lit_by_ring

PITCH_UM = 20.0
WIDTH_MM = 1e-3 * PITCH_UM * SHAPE[1]


@pytest.mark.slow
def test_stated_places_make_another_calibration_with_the_same_heights(
    ring_presses: Sequence[PressFrame], ring_calibration: Calibration
) -> None:
    turn = 2.0 * np.pi * np.arange(3) / 3.0 + 0.3
    places = WIDTH_MM * np.stack([2.0 * np.cos(turn), 2.0 * np.sin(turn), np.full(3, 2.8)], axis=-1)
    lights_mm = [(right, down, up) for right, down, up in places.tolist()]
    stated, again = (
        calibrate(ring_presses, lit_by_ring(np.zeros(SHAPE), 3, 99), PITCH_UM, lights_mm=lamps)
        for lamps in (lights_mm, ())
    )
    assert again.calibration_id == ring_calibration.calibration_id
    assert stated.calibration_id != ring_calibration.calibration_id
    z = press_px(Ball(170.0, 120.0, 28.0, RADIUS_PX), 15.0)
    for calibration in (stated, again):
        found = reconstruct(lit_by_ring(z, 3, 501), calibration, "ball").height.z_um
        assert abs(float(found.max()) / (PITCH_UM * float(z.max())) - 1.0) < 0.03
