"""The twin's camera: free-running frames and delayed controls, granted as the sensor's driver grants them.

Settings that each sensor makes of a request: exposures in whole lines, gains by codes, and the limits of both.

Codes and limits are those of the kernel drivers; how a request becomes a code, and which largest one libcamera lets
through, is that of libcamera's camera helpers. A request beyond the limits is clamped without an error.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from hal.errors import CameraError, FrameTimeout
from hal.frame import CameraSettings, RawFrame
from hal.simulator.bench import SimulatedScene


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
        """Return the sensor's gain for a request: libcamera cuts its code to a whole number."""
        code = math.floor(200.0 * math.log10(asked) if self.in_decibels else 1024.0 - 1024.0 / asked)
        return self.gain(min(max(code, self.codes[0]), self.codes[1]))

    def gain(self, code: int) -> float:
        """Return the gain of a code, in the single precision of metadata."""
        return float(np.float32(10.0 ** (code / 200.0) if self.in_decibels else 1024.0 / (1024.0 - code)))

    def granted_exposure_us(self, asked_us: float, step_us: float, frame_us: float | None) -> float:
        """Return the exposure for a request, in whole µs as metadata state it; no longer than a locked frame allows."""
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


AIMING_STEP: Final = 2
_POWER_ON: Final = CameraSettings(exposure_us=9_990.0, analogue_gain=1.0)
_READOUT_US: Final = 1_000.0


class TwinCamera:
    """A free-running raw camera; see `hal.interfaces.Camera`."""

    def __init__(self, bench: SimulatedScene) -> None:
        self._bench = bench
        self._streaming = False
        self._current = _POWER_ON
        self._pending: deque[tuple[int, CameraSettings]] = deque()
        self._index = 0
        self._began_ns = 0

    @property
    def camera_id(self) -> str:
        """Identity of the simulated camera."""
        return f"twin/{self._bench.profile.sensor.model}"

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every raw frame, in sensor pixels."""
        sensor = self._bench.profile.sensor
        return sensor.rows, sensor.columns

    def apply(self, settings: CameraSettings) -> None:
        """Request exposure and gain; they act some frames later, or from the first frame when not yet streaming."""
        self._check_present()
        if self._bench.faults.controls_ignored:
            return
        if not self._streaming:
            self._current = self._granted(settings)
            return
        self._catch_up()
        self._pending.append((self._index + self._bench.twin.control_delay_frames, self._granted(settings)))

    def next_frame(self, timeout_s: float) -> RawFrame:
        """Return the next frame whose read-out ends after now.

        Raises
        ------
        FrameTimeout
            None was completed within `timeout_s`.
        CameraError
            The camera is missing or not started.
        """
        self._check_present()
        if not self._streaming:
            raise CameraError(f"camera {self.camera_id} is not started: enter it before asking for a frame")
        clock = self._bench.clock
        self._catch_up()
        wait_s = (self._completed_ns() - clock.monotonic_ns()) * 1e-9
        if self._bench.faults.camera_stalled or wait_s > timeout_s:
            clock.sleep(timeout_s)
            raise FrameTimeout(f"camera {self.camera_id} completed no frame within {timeout_s:g} s: check its cable")
        clock.sleep(wait_s)
        frame = self._bench.expose(self._index, self._began_ns, self._current)
        self._advance()
        return frame

    def aiming_view(self, timeout_s: float) -> NDArray[np.uint8]:
        """Return the next frame's green pixels, every `AIMING_STEP`-th, as 8 bits: uint8 array of shape (h, w)."""
        frame = self.next_frame(timeout_s)
        column = frame.bayer_order.index("G") % 2
        green = frame.mosaic[0 :: 2 * AIMING_STEP, column :: 2 * AIMING_STEP].astype(np.float32)
        fraction = (green - frame.black_level_dn) / (frame.white_level_dn - frame.black_level_dn)
        return np.asarray(np.clip(255.0 * fraction, 0.0, 255.0), np.uint8)

    def __enter__(self) -> Self:
        self._check_present()
        self._streaming = True
        self._began_ns = self._bench.clock.monotonic_ns()
        return self

    def __exit__(self, *exc: object) -> None:
        self._streaming = False
        self._pending.clear()

    def _check_present(self) -> None:
        if self._bench.faults.camera_missing:
            raise CameraError(f"camera {self.camera_id} is not there: check its cable and the board profile")

    def _catch_up(self) -> None:
        """Skip all frames that were complete before now."""
        now_ns = self._bench.clock.monotonic_ns()
        while self._pending and self._completed_ns() <= now_ns:
            self._advance()
        missed = (now_ns - self._completed_ns()) // self._period_ns() + 1
        if missed > 0:
            self._index += missed
            self._began_ns += missed * self._period_ns()

    def _advance(self) -> None:
        """Begin the next frame, with the controls that are due for it."""
        self._began_ns += self._period_ns()
        self._index += 1
        while self._pending and self._pending[0][0] <= self._index:
            self._current = self._pending.popleft()[1]

    def _completed_ns(self) -> int:
        return self._began_ns + round((self._current.exposure_us + _READOUT_US) * 1e3)

    def _period_ns(self) -> int:
        return round(max(self._bench.twin.frame_period_us, self._current.exposure_us + _READOUT_US) * 1e3)

    def _granted(self, asked: CameraSettings) -> CameraSettings:
        """Return the settings that the sensor grants of a request."""
        profile = self._bench.profile
        frame_us = None if profile.libcamera is None else profile.libcamera.frame_period_us
        return granted(profile.sensor.model, asked, profile.sensor.exposure_step_us, frame_us)
