"""One proven frame: taken with the exposure, gain and light that were asked for, and after they were there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from device.errors import FrameError, FrameNotProven
from device.fingerprint import Fingerprint
from hal.board_profile import SensorFacts
from hal.frame import CameraSettings, RawFrame
from hal.hardware import Hardware

SETTLE_S: Final = 0.005
"""Lights are steady this long after they were switched."""

FRAME_TIMEOUT_S: Final = 2.0
MOST_FRAMES: Final = 16
"""Controls act some frames late; a camera that has not obeyed after so many does not obey."""

RELATIVE_TOLERANCE: Final = 0.02
"""Granted exposure and gain come back close to what was asked, not equal."""


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """How a frame is to be taken: camera settings and the current of each light as its driver grants it, mA."""

    settings: CameraSettings
    currents_ma: Mapping[str, float]

    @classmethod
    def of_board(cls, hardware: Hardware) -> CapturePlan:
        """The plan that the board profile states."""
        return cls(hardware.profile.camera.settings, hardware.lights.granted_ma(hardware.profile.currents_ma))

    @classmethod
    def of_calibration(cls, hardware: Hardware, fingerprint: Fingerprint) -> CapturePlan:
        """The plan that a calibration was made with: exposure, gain and currents may have been balanced for it."""
        currents_ma = {light.name: light.current_ma for light in fingerprint.lights}
        settings = CameraSettings(fingerprint.exposure_us, fingerprint.analogue_gain)
        return cls(settings, hardware.lights.granted_ma(currents_ma))


def capture(hardware: Hardware, plan: CapturePlan) -> RawFrame:
    """The first frame whose metadata proves the plan; the lights are dark again afterwards.

    Raises
    ------
    FrameNotProven
        No frame showed the asked exposure and gain with its exposure begun after the lights had settled.
    FrameError
        The camera delivers another size, Bayer order or scale than the board profile states.
    CameraError, LightError
        The hardware did not answer.
    """
    camera, lights, clock = hardware.camera, hardware.lights, hardware.clock
    camera.apply(plan.settings)
    try:
        lights.switch_on(plan.currents_ma)
        steady_ns = clock.monotonic_ns() + round(SETTLE_S * 1e9)
        for _ in range(MOST_FRAMES):
            frame = camera.next_frame(FRAME_TIMEOUT_S)
            check_frame(frame, hardware.profile.sensor, camera.camera_id)
            if _proves(frame, plan.settings, steady_ns):
                return frame
    finally:
        lights.dark()
    raise FrameNotProven(
        f"none of {MOST_FRAMES} frames of camera {camera.camera_id} showed exposure {plan.settings.exposure_us:g} µs "
        f"and gain {plan.settings.analogue_gain:g} under steady light (last: {frame.granted.exposure_us:g} µs, "
        f"{frame.granted.analogue_gain:g}): press again, and check the camera if it persists"
    )


def check_frame(frame: RawFrame, sensor: SensorFacts, camera_id: str) -> None:
    """Refuse a frame that is not of the sensor that the board profile states.

    Raises
    ------
    FrameError
        Names the camera, what differs, and the key to mend.
    """
    for key, found, stated in (
        ("rows, sensor.columns", frame.shape, (sensor.rows, sensor.columns)),
        ("bayer_order", frame.bayer_order, sensor.bayer_order),
        ("white_level_dn", frame.white_level_dn, sensor.white_level_dn),
    ):
        if found != stated:
            raise FrameError(
                f"camera {camera_id} delivers {found} where the board profile says {stated}: check that it is the "
                f"right camera, and sensor.{key}"
            )


def _proves(frame: RawFrame, asked: CameraSettings, steady_ns: int) -> bool:
    return (
        frame.sensor_timestamp_ns >= steady_ns
        and _close(frame.granted.exposure_us, asked.exposure_us)
        and _close(frame.granted.analogue_gain, asked.analogue_gain)
    )


def _close(granted: float, asked: float) -> bool:
    return abs(granted - asked) <= RELATIVE_TOLERANCE * asked
