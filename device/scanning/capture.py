"""One proven frame: taken with the exposure, gain and light that were asked for, and after they were there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, TypeVar

from device.errors import FrameError, FrameNotProven
from device.fingerprint import Fingerprint
from device.settings_record import SettingsRecord
from hal.board_profile import SensorFacts
from hal.errors import FrameTimeout, LightError
from hal.frame import CameraSettings, RawFrame
from hal.hardware import Hardware
from hal.interfaces import Camera, LightFault, Lights

SETTLE_S: Final = 0.005
"""Lights are steady this long after they were switched."""

FRAME_TIMEOUT_S: Final = 2.0
MOST_FRAMES: Final = 16
"""Controls act some frames late; a camera that has not obeyed after so many does not obey."""

MOST_RESTARTS: Final = 2
"""A camera that delivers nothing is opened anew this often before it is given up."""

RELATIVE_TOLERANCE: Final = 0.02
"""Granted exposure and gain come back close to what was asked, not equal."""

SAME_GAIN: Final = 1e-3
LEAST_TOLERANCE_US: Final = 1.0
"""What was granted once is granted again: relative, and in the whole µs that libcamera tells."""

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """How a frame is to be taken.

    settings : what the camera is asked for
    currents_ma : of each light as its driver grants it, mA
    granted : what a frame must show, such as the calibration's did; near what is asked when None
    """

    settings: CameraSettings
    currents_ma: Mapping[str, float]
    granted: CameraSettings | None = None

    @classmethod
    def of_board(cls, hardware: Hardware) -> CapturePlan:
        """The plan that the board profile states."""
        return cls(hardware.profile.camera.settings, hardware.lights.granted_ma(hardware.profile.currents_ma))

    @classmethod
    def of_calibration(
        cls, hardware: Hardware, fingerprint: Fingerprint, asked: SettingsRecord | None = None
    ) -> CapturePlan:
        """The plan that a calibration was made with: exposure, gain and currents may have been balanced for it.

        What was granted is not asked for again, since sensors cut an exposure to whole steps: it could lose one more.
        A calibration that does not tell what was asked is taken half a step up, which is cut to the same.
        """
        currents_ma = {light.name: light.current_ma for light in fingerprint.lights}
        granted = CameraSettings(fingerprint.exposure_us, fingerprint.analogue_gain)
        half_step_us = 0.5 * hardware.profile.sensor.exposure_step_us
        again = CameraSettings(granted.exposure_us + half_step_us, granted.analogue_gain)
        return cls(asked.settings if asked else again, hardware.lights.granted_ma(currents_ma), granted)

    def proves(self, granted: CameraSettings, step_us: float) -> bool:
        """Whether settings that a frame shows are this plan's; exposures come in steps of `step_us`."""
        if self.granted is not None:
            near_us = max(0.5 * step_us, LEAST_TOLERANCE_US)
            wanted, near_gain = self.granted, SAME_GAIN * self.granted.analogue_gain
        else:
            near_us = max(RELATIVE_TOLERANCE * self.settings.exposure_us, step_us + LEAST_TOLERANCE_US)
            wanted, near_gain = self.settings, RELATIVE_TOLERANCE * self.settings.analogue_gain
        return (
            abs(granted.exposure_us - wanted.exposure_us) <= near_us
            and abs(granted.analogue_gain - wanted.analogue_gain) <= near_gain
        )


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A proven frame, and what the light driver said while it was lit (None: it could not be asked)."""

    frame: RawFrame
    light_faults: tuple[LightFault, ...] | None


def capture(hardware: Hardware, plan: CapturePlan) -> RawFrame:
    """The frame of `take`, for whoever does not ask after the light driver."""
    return take(hardware, plan).frame


def take(hardware: Hardware, plan: CapturePlan) -> Shot:
    """The first frame whose metadata proves the plan; the lights are dark again afterwards.

    Raises
    ------
    FrameNotProven
        No frame showed the asked exposure and gain with its exposure begun after the lights had settled.
    FrameError
        The camera delivers another size, Bayer order or scale than the board profile states.
    FrameTimeout
        The camera delivers nothing, however often it is opened anew.
    CameraError, LightError
        The hardware did not answer.
    """
    return after_restarts(hardware.camera, lambda: _take(hardware, plan))


def after_restarts(camera: Camera, act: Callable[[], Result]) -> Result:
    """What `act` returns, tried again when the camera delivers nothing: its next call opens a stalled camera anew.

    Raises
    ------
    FrameTimeout
        It delivers nothing after `MOST_RESTARTS` restarts.
    """
    for _ in range(MOST_RESTARTS):
        with suppress(FrameTimeout):
            return act()
    try:
        return act()
    except FrameTimeout as error:
        raise FrameTimeout(
            f"camera {camera.camera_id} delivers no frame, though it was restarted {MOST_RESTARTS} times: check its "
            "ribbon cable at both ends and its supply"
        ) from error


def _take(hardware: Hardware, plan: CapturePlan) -> Shot:
    """The same without a restart; a camera that has stalled is opened anew before any light is on."""
    camera, lights, clock = hardware.camera, hardware.lights, hardware.clock
    step_us = hardware.profile.sensor.exposure_step_us
    camera.apply(plan.settings)
    try:
        lights.switch_on(plan.currents_ma)
        steady_ns = clock.monotonic_ns() + round(SETTLE_S * 1e9)
        for _ in range(MOST_FRAMES):
            frame = camera.next_frame(FRAME_TIMEOUT_S)
            check_frame(frame, hardware.profile.sensor, camera.camera_id)
            if frame.sensor_timestamp_ns >= steady_ns and plan.proves(frame.granted, step_us):
                return Shot(frame, _asked_faults(lights))
    finally:
        lights.dark()
    wanted = plan.granted or plan.settings
    raise FrameNotProven(
        f"none of {MOST_FRAMES} frames of camera {camera.camera_id} showed exposure {wanted.exposure_us:g} µs "
        f"and gain {wanted.analogue_gain:g} under steady light (last: {frame.granted.exposure_us:g} µs, "
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


def _asked_faults(lights: Lights) -> tuple[LightFault, ...] | None:
    """What the driver says of its lights; a driver that cannot be asked costs no frame that is proven."""
    try:
        return lights.faults()
    except LightError:
        return None
