"""Changes of a frame's lights that slopes are corrected for."""

from __future__ import annotations

import numpy as np
import pytest

from device.imaging.frame_light import FrameLight
from host_sync.frame_checks.level_check import check_light, is_light

BALANCED = FrameLight(np.array([1.1, 0.97, 1.35]), np.zeros(3))
"""Gains of a camera that balances white by itself."""

STEADY, UNSTEADY = 0.005, 0.1
"""Standard deviations of the gains of a calibration's presses."""


def test_a_light_may_differ_by_four_standard_deviations_of_the_presses() -> None:
    assert not is_light(BALANCED, STEADY)
    assert is_light(BALANCED, UNSTEADY)
    assert not is_light(FrameLight(np.array([1.0, 1.0, 1.45]), np.zeros(3)), UNSTEADY)


def test_an_offset_is_no_light_however_far_presses_differ() -> None:
    assert not is_light(FrameLight(np.ones(3), np.array([0.0, 0.0, 0.06])), UNSTEADY)


def test_the_check_states_the_limit_of_its_calibration() -> None:
    drift, _ = check_light(BALANCED, STEADY)
    assert (drift.outcome, drift.limit) == ("refused", 0.15)
    assert drift.words == "its lights differ from the calibration's by 35% (at most 15%)"
    drift, _ = check_light(BALANCED, UNSTEADY)
    assert (drift.outcome, drift.limit) == ("passed", pytest.approx(0.4))
