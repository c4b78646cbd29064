"""Settings that each sensor makes of a request: exposures in whole lines, gains by codes, and the limits of both.

Codes and limits are those of the kernel drivers; how a request becomes a code, and which largest one libcamera lets
through, is that of libcamera's camera helpers. A request beyond the limits is clamped without an error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hal.frame import CameraSettings


@dataclass(frozen=True, slots=True)
class SensorControls:
    """One sensor's controls.

    codes : smallest and largest gain code
    in_decibels : codes are tenths of a decibel; otherwise the gain is 1024 / (1024 - code)
    lines_per_step : exposures are multiples of so many lines
    min_lines : shortest exposure, lines
    offset_us : exposure beyond its lines, µs
    blank_lines : a frame is this much longer than its exposure at least, lines
    """

    codes: tuple[int, int]
    in_decibels: bool = False
    lines_per_step: int = 1
    min_lines: int = 1
    offset_us: float = 0.0
    blank_lines: int = 0

    def granted_gain(self, asked: float) -> float:
        """The sensor's gain for a request: libcamera cuts its code to a whole number."""
        code = math.floor(200.0 * math.log10(asked) if self.in_decibels else 1024.0 - 1024.0 / asked)
        return self.gain(min(max(code, self.codes[0]), self.codes[1]))

    def gain(self, code: int) -> float:
        """The gain of a code, in the single precision of metadata."""
        return float(np.float32(10.0 ** (code / 200.0) if self.in_decibels else 1024.0 / (1024.0 - code)))

    def granted_exposure_us(self, asked_us: float, step_us: float, frame_us: float | None) -> float:
        """The exposure for a request, in whole µs as metadata state it; no longer than a locked frame allows."""
        line_us = step_us / self.lines_per_step
        lines = math.floor((asked_us - self.offset_us) / line_us)
        if frame_us is not None:
            lines = min(lines, math.floor(frame_us / line_us) - self.blank_lines)
        steps = math.floor((lines - self.min_lines) / self.lines_per_step + 0.5)  # the kernel rounds to its own steps
        lines = self.min_lines + max(steps, 0) * self.lines_per_step
        return float(math.floor(lines * line_us + self.offset_us))


SENSORS: Final = {
    "IMX296": SensorControls((0, 239), in_decibels=True, offset_us=14.26, blank_lines=4),
    "IMX477": SensorControls((0, 978), min_lines=4, blank_lines=22),
    "IMX708": SensorControls((112, 960), lines_per_step=2, min_lines=4, blank_lines=48),
}
"""By model; the IMX708 in its binned mode. Of the IMX296's 480 codes libcamera reaches 239."""

OTHER: Final = SensorControls((0, 480), in_decibels=True)
"""A model without an entry."""


def granted(model: str, asked: CameraSettings, step_us: float, frame_us: float | None = None) -> CameraSettings:
    """Return what a sensor makes of a request.

    step_us : the profile's exposure step, µs
    frame_us : locked frame duration, µs, or None where frames grow with their exposure
    """
    controls = SENSORS.get(model, OTHER)
    exposure_us = controls.granted_exposure_us(asked.exposure_us, step_us, frame_us)
    return CameraSettings(max(exposure_us, 1.0), controls.granted_gain(max(asked.analogue_gain, 1.0)))
