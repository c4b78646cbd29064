"""Exposures and analogue gains of each sensor: what libcamera grants of a request.

Gain codes and limits are those of the kernel drivers and of libcamera's camera helpers: IMX296 in tenths of a decibel
from 0 to 480; IMX477 as 1024 / (1024 - code) with codes 0 to 978; IMX708 the same with codes 112 to 960, so its
smallest gain is 1.1228. A request beyond the limits is clamped without an error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from hal.frame import CameraSettings


@dataclass(frozen=True, slots=True)
class SensorControls:
    """Limits of one sensor.

    codes : smallest and largest gain code
    in_decibels : codes are tenths of a decibel; otherwise the gain is 1024 / (1024 - code)
    min_lines : shortest exposure, lines
    """

    codes: tuple[int, int]
    in_decibels: bool = False
    min_lines: int = 1

    def granted_gain(self, asked: float) -> float:
        """The sensor's gain for a request."""
        code = round(200.0 * math.log10(asked)) if self.in_decibels else math.floor(1024.0 - 1024.0 / asked)
        return self.gain(min(max(code, self.codes[0]), self.codes[1]))

    def gain(self, code: int) -> float:
        """The gain of a code."""
        return 10.0 ** (code / 200.0) if self.in_decibels else 1024.0 / (1024.0 - code)


CONTROLS: Final = {
    "IMX296": SensorControls((0, 480), in_decibels=True),
    "IMX477": SensorControls((0, 978), min_lines=4),
    "IMX708": SensorControls((112, 960)),
}


def granted(model: str, asked: CameraSettings, step_us: float) -> CameraSettings:
    """What the sensor does of a request: whole lines of exposure, reported in whole µs, and the gain of a code.

    A model without an entry behaves as the IMX296.
    """
    controls = CONTROLS.get(model, CONTROLS["IMX296"])
    lines = max(math.floor(asked.exposure_us / step_us), controls.min_lines)
    exposure_us = float(max(math.floor(lines * step_us), 1))
    return CameraSettings(exposure_us, controls.granted_gain(max(asked.analogue_gain, 1.0)))
