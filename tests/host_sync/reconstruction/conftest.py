"""A calibration of matt skin under three lights of a ring, made once in a session from few balls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from near_lamps import RADIUS_PX, SHAPE, balls, press_px

from host_sync.calibration.balls import PressFrame
from host_sync.calibration.calibrate import Calibration, calibrate
from tests.apparatus.light_ring import lit_by_ring

RING_PITCH_UM = 20.0


@pytest.fixture(scope="session")
def ring_presses() -> Sequence[PressFrame]:
    """Four balls spread over the field."""
    return [
        PressFrame(f"press-{number:02d}", lit_by_ring(press_px(*ball), 3, number), RADIUS_PX)
        for number, ball in enumerate(balls()[::3])
    ]


@pytest.fixture(scope="session")
def ring_calibration(ring_presses: Sequence[PressFrame]) -> Calibration:
    return calibrate(ring_presses, lit_by_ring(np.zeros(SHAPE), 3, 99), RING_PITCH_UM)
