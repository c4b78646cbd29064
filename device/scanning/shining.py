"""Whether a light shines at all, seen alone: what others leak into its colour would else be taken for it."""

from __future__ import annotations

from typing import Final

from device.errors import CalibrationError
from device.exposure_levels import BRIGHTEST_PERCENTILE, channel_levels
from device.scanning.capture import CapturePlan, take
from hal.board_profile import LightFacts
from hal.hardware import Hardware

LEAST_LEVEL: Final = 0.02
"""A light that the camera sees less of, as a share of full scale, does not shine."""


def check_shines(hardware: Hardware, plan: CapturePlan, light: LightFacts) -> str:
    """What the driver says of a light that is seen, such as "open", or an empty text.

    Raises
    ------
    CalibrationError
        It is not seen.
    """
    alone = CapturePlan(plan.settings, {light.name: plan.currents_ma[light.name]})
    shot = take(hardware, alone)
    told = ", ".join(fault.kind for fault in shot.light_faults or () if fault.light == light.name)
    if channel_levels(shot.frame, BRIGHTEST_PERCENTILE)["RGB".index(light.colour)] < LEAST_LEVEL:
        driver = f" (the driver says {told})" if told else ""
        raise CalibrationError(f"light {light.name} is hardly seen{driver}: run `retroscan selftest` to find out why")
    return told
