"""Changes of a frame's lights that slopes are corrected for."""

from __future__ import annotations

import numpy as np
import pytest

from device.imaging.frame_light import FrameLight
from host_sync.frame_checks.level_check import LevelModel, change_below, is_light

STEADY = LevelModel(np.full(3, -0.06), np.full(3, 0.06), (-0.06, 0.06), None)
BALANCED = LevelModel(np.array([-0.2, -0.06, -0.3]), np.array([0.15, 0.06, 0.4]), (-0.1, 0.1), None)
"""Levels of presses under steady lights, and of those of a camera that balances white by itself."""


def light(red: float, green: float, blue: float, offset: float = 0.0) -> FrameLight:
    return FrameLight(np.array([red, green, blue]), np.array([0.0, 0.0, offset]))


@pytest.mark.parametrize(
    ("model", "gains", "outcome", "value", "limit"),
    [
        (STEADY, (1.1, 0.97, 1.35), "refused", 0.35, 0.15),
        (STEADY, (1.14, 1.0, 1.0), "passed", 0.14, 0.15),
        (BALANCED, (1.1, 0.97, 1.35), "passed", 0.35, np.expm1(0.4)),
        (BALANCED, (1.0, 1.2, 1.35), "refused", 0.2, 0.15),
        (BALANCED, (1.0, 1.0, 0.7), "refused", 0.3, -np.expm1(-0.3)),
        (BALANCED, (1.0, 1.0, 0.05), "refused", 0.95, -np.expm1(-0.3)),
    ],
)
def test_a_light_may_differ_as_far_as_presses_show_of_its_channel(
    model: LevelModel, gains: tuple[float, float, float], outcome: str, value: float, limit: float
) -> None:
    drift, stray = model.check_light(light(*gains))
    assert (drift.name, drift.outcome, stray.outcome) == ("light drift", outcome, "passed")
    assert (drift.value, drift.limit) == (pytest.approx(value), pytest.approx(limit))


def test_a_refusal_states_change_and_limit() -> None:
    drift, _ = STEADY.check_light(light(1.0, 1.0, 1.35))
    assert drift.words == "its lights differ from the calibration's by 35% (at most 15%)"
    _, stray = BALANCED.check_light(light(1.0, 1.0, 1.0, 0.06))
    assert stray.words == "light of the surroundings is, of full scale, 6% (at most 5%)"


def test_lights_of_a_press_may_change_by_half_and_its_surroundings_hardly() -> None:
    assert is_light(light(1.1, 0.97, 1.45))
    assert not is_light(light(1.0, 1.0, 0.4))
    assert not is_light(light(1.0, 1.0, 1.0, 0.06))


def test_a_change_that_percent_do_not_describe_has_no_figure() -> None:
    assert change_below(0.2) == "a change of the lights below 22%"
    assert change_below(7.78) == "any change of the lights"
