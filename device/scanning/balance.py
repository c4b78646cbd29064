"""Exposure and the three currents, set once so that ball presses use the sensor's range and do not saturate it.

Near light varies several-fold over the field, and a slope that faces a light is brighter than the flat skin: a flat at
half of full scale would clip. So the brightest of a ball press rules, pressed where the field comes nearest to each
light, and the flat level follows from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from device.errors import CalibrationError
from device.exposure_levels import BRIGHTEST_PERCENTILE, Levels, channel_levels
from device.scanning.capture import CapturePlan, capture
from device.scanning.pushing import await_push
from device.scanning.shining import check_shines
from hal.board_profile import LightFacts, SensorFacts
from hal.frame import CameraSettings
from hal.hardware import Hardware
from hal.interfaces import PressBall

AIMED_LEVEL: Final = 0.84
"""Where the brightest is put: what filters pass of other lights, and a light's coarsest step, still fit below."""

SATURATED_LEVEL: Final = 0.95
MOST_HALVINGS: Final = 4
FEWEST_STEPS: Final = 50
"""Shorter exposures come in coarse steps: a line of the sensor, or two, would be more than 2 %."""

HIGHEST_CURRENT_SHARE: Final = 0.9
LOWEST_CURRENT_SHARE: Final = 0.05
"""Of what a light can be driven with: below, the driver's steps are coarse; above, LEDs grow hot."""

NEAREST_BORDER: Final = (1 / 8, 1 / 6)
"""Shares of the field's columns and rows that a press keeps from its borders, as the calibration's presses do."""


@dataclass(frozen=True, slots=True)
class Balance:
    """The plan that was found, and the brightest level that ball presses reach with it, as predicted."""

    plan: CapturePlan
    predicted: Levels


def balance(hardware: Hardware, ball_radius_mm: float, tell: Callable[[str], None]) -> Balance:
    """Exposure and currents for this gel and these lights, from a ball pressed near each light.

    Raises
    ------
    CalibrationError
        A light is too weak or the frame saturates however weak the lights.
    HalError, FrameNotProven
        The hardware refused.
    """
    plan = CapturePlan.of_board(hardware)
    responses = []
    for light in hardware.profile.lights:
        tell(f"Balance: press the ball as near to light {light.name} as the field goes, hold it, push the button.")
        await_push(hardware, PressBall(ball_radius_mm, *_nearest_place(hardware.profile.sensor, light)))
        check_shines(hardware, plan, light)
        responses.append(_response(hardware, plan))
    highest = [max(values) for values in zip(*responses, strict=True)]
    found = _plan_for(hardware, plan.settings, highest)
    red, green, blue = (
        response * current * found.settings.exposure_us
        for response, current in zip(highest, found.currents_ma.values(), strict=True)
    )
    return Balance(found, (red, green, blue))


def _nearest_place(sensor: SensorFacts, light: LightFacts) -> tuple[float, float]:
    """Where the field comes nearest to a light, as shares of its columns and rows."""
    shares = [
        0.5 + position_mm / (size * sensor.pixel_pitch_um * 1e-3)
        for position_mm, size in zip(light.position_mm[:2], (sensor.columns, sensor.rows), strict=True)
    ]
    column, row = (min(max(share, b), 1.0 - b) for share, b in zip(shares, NEAREST_BORDER, strict=True))
    return column, row


def _response(hardware: Hardware, plan: CapturePlan) -> list[float]:
    """Brightest level of each channel per mA and µs; the currents are halved until nothing saturates."""
    for halving in range(MOST_HALVINGS + 1):
        asked = {name: current / 2**halving for name, current in plan.currents_ma.items()}
        currents_ma = hardware.lights.granted_ma(asked)
        frame = capture(hardware, CapturePlan(plan.settings, currents_ma))
        levels = channel_levels(frame, BRIGHTEST_PERCENTILE)
        if max(levels) >= SATURATED_LEVEL:
            continue
        exposed_us = frame.granted.exposure_us
        return [level / (c * exposed_us) for level, c in zip(levels, currents_ma.values(), strict=True)]
    raise CalibrationError(
        f"the frame saturates even with the currents divided by {2**MOST_HALVINGS}: keep daylight out, or shorten "
        "camera.exposure_us"
    )


def _plan_for(hardware: Hardware, settings: CameraSettings, responses: list[float]) -> CapturePlan:
    """The plan that brings every channel to the aimed level: the board's exposure unless a current is out of reach."""
    lights = hardware.lights
    doses = [AIMED_LEVEL / response for response in responses]
    longest_us = hardware.profile.libcamera.frame_period_us if hardware.profile.libcamera else 1e6
    enough_us = max(doses) / (HIGHEST_CURRENT_SHARE * lights.highest_ma)
    fine_us = min(doses) / (LOWEST_CURRENT_SHARE * lights.highest_ma)
    shortest_us = min(FEWEST_STEPS * hardware.profile.sensor.exposure_step_us, longest_us)
    exposure_us = max(min(settings.exposure_us, fine_us), enough_us, shortest_us)
    if exposure_us > longest_us:
        weakest = lights.names[doses.index(max(doses))]
        raise CalibrationError(
            f"light {weakest} is too weak: {exposure_us:.0f} µs would be needed and {longest_us:.0f} µs are possible; "
            "raise the gain or mount it closer"
        )
    asked = {name: dose / exposure_us for name, dose in zip(lights.names, doses, strict=True)}
    return CapturePlan(CameraSettings(exposure_us, settings.analogue_gain), lights.granted_ma(asked))
