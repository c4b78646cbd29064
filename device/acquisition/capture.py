"""Confirmed frames: exposure, gain and light were as requested before the exposure began."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, TypeVar

from device.bundles.fingerprint import Fingerprint, SettingsRecord
from device.errors import FrameError, FrameNotConfirmed
from hal.board_profile import SensorConfig
from hal.errors import FrameTimeout, LightError
from hal.frame import AS_GRANTED, WHOLE_US, BayerOrder, CameraSettings, RawFrame
from hal.hardware import Hardware
from hal.interfaces import Camera, LightFault, Lights

SETTLE_S: Final = 0.005
"""Lights are steady this long after switching."""

FRAME_TIMEOUT_S: Final = 2.0
MAX_FRAMES: Final = 16
"""Camera controls take effect some frames late; after this many frames without effect the capture fails."""

MAX_RESTARTS: Final = 2
"""How often a camera that delivers nothing is reopened before the capture fails."""

SAME_GAIN: Final = 1e-3
"""Relative tolerance of the gain when the same settings are granted again."""

GAIN_MARGIN: Final = 1e-5
"""Relative margin of a gain that is requested again: less than any sensor's code, more than single precision loses."""

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """Settings of the camera and the lights for one frame.

    settings : requested from the camera
    currents_ma : of each light as its driver grants it, mA
    granted : settings that a frame must show, for example the calibration's; None: close to the requested ones
    bayer_order : that of the calibration's frames, for a board whose order is as granted
    """

    settings: CameraSettings
    currents_ma: Mapping[str, float]
    granted: CameraSettings | None = None
    bayer_order: BayerOrder | None = None

    @classmethod
    def of_board(cls, hardware: Hardware) -> CaptureSettings:
        """Return the settings in the board profile."""
        return cls(hardware.profile.camera.settings, hardware.lights.granted_ma(hardware.profile.currents_ma))

    @classmethod
    def of_calibration(
        cls, hardware: Hardware, fingerprint: Fingerprint, asked: SettingsRecord | None = None
    ) -> CaptureSettings:
        """Return the settings of a calibration, whose exposure, gain and currents may come from `auto_exposure`.

        What was granted is not requested again: sensors truncate exposures to whole steps and gains to whole codes, and
        could lose one more. Without a record of what was requested, a quarter of a step is added, and a little of a
        code to the gain, which are cut off again; half a step, where a step has two lines, may round to the next.
        """
        currents_ma = {light.name: light.current_ma for light in fingerprint.lights}
        granted = CameraSettings(fingerprint.exposure_us, fingerprint.analogue_gain)
        quarter_us = 0.25 * hardware.profile.sensor.exposure_step_us
        again = CameraSettings(granted.exposure_us + quarter_us, granted.analogue_gain * (1.0 + GAIN_MARGIN))
        return cls(asked.settings if asked else again, hardware.lights.granted_ma(currents_ma), granted)

    def matches(self, granted: CameraSettings, step_us: float) -> bool:
        """Return whether settings that a frame shows are these; exposures come in steps of `step_us`."""
        if self.granted is None:
            return self.settings.is_granted(granted, step_us)
        return (
            abs(granted.exposure_us - self.granted.exposure_us) <= max(0.5 * step_us, WHOLE_US)
            and abs(granted.analogue_gain - self.granted.analogue_gain) <= SAME_GAIN * self.granted.analogue_gain
        )


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """A confirmed frame, and the light driver's faults during its exposure (None: could not be read)."""

    frame: RawFrame
    light_faults: tuple[LightFault, ...] | None


def capture(hardware: Hardware, plan: CaptureSettings) -> RawFrame:
    """Return a confirmed frame without the light driver's faults. Errors as for `capture_with_faults`."""
    return capture_with_faults(hardware, plan).frame


def capture_with_faults(hardware: Hardware, plan: CaptureSettings, *, keep_lit: bool = False) -> Capture:
    """Return the first frame whose metadata matches the plan; the lights are off again afterwards, unless `keep_lit`.

    Raises
    ------
    FrameNotConfirmed
        No frame showed the requested exposure and gain after the lights had settled.
    FrameError
        Size, Bayer order or scale differ from the board profile.
    FrameTimeout
        The camera delivers nothing, even after `MAX_RESTARTS` restarts.
    CameraError, LightError
        The hardware did not answer.
    """
    return retry_with_restart(hardware.camera, lambda: _capture(hardware, plan, keep_lit=keep_lit))


def retry_with_restart(camera: Camera, act: Callable[[], Result]) -> Result:
    """Return the result of `act`, retried when the camera delivers nothing; the camera reopens itself on the next call.

    Raises
    ------
    FrameTimeout
        It still delivers nothing after `MAX_RESTARTS` restarts.
    """
    for _ in range(MAX_RESTARTS):
        with suppress(FrameTimeout):
            return act()
    try:
        return act()
    except FrameTimeout as error:
        raise FrameTimeout(
            f"camera {camera.camera_id} delivers no frame, even after {MAX_RESTARTS} restarts: check its "
            "ribbon cable at both ends and its supply"
        ) from error


def _capture(hardware: Hardware, plan: CaptureSettings, *, keep_lit: bool) -> Capture:
    # A stalled camera is reopened by `apply`, before any light is on.
    camera, lights, clock = hardware.camera, hardware.lights, hardware.clock
    step_us = hardware.profile.sensor.exposure_step_us
    camera.apply(plan.settings)
    is_kept = False
    try:
        lights.switch_on(plan.currents_ma)
        steady_ns = clock.monotonic_ns() + round(SETTLE_S * 1e9)
        for _ in range(MAX_FRAMES):
            frame = camera.next_frame(FRAME_TIMEOUT_S)
            check_frame(frame, hardware.profile.sensor, camera.camera_id, plan.bayer_order)
            if frame.sensor_timestamp_ns >= steady_ns and plan.matches(frame.granted, step_us):
                found = Capture(frame, _faults(lights))
                is_kept = keep_lit
                return found
    finally:
        if not is_kept:
            lights.off()
    wanted = plan.granted or plan.settings
    raise FrameNotConfirmed(
        f"none of {MAX_FRAMES} frames of camera {camera.camera_id} showed exposure {wanted.exposure_us:g} µs "
        f"and gain {wanted.analogue_gain:g} under steady light (last: {frame.granted.exposure_us:g} µs, "
        f"{frame.granted.analogue_gain:g}): press again; if it happens again, check the camera"
    )


def check_frame(
    frame: RawFrame, sensor: SensorConfig, camera_id: str, calibrated_order: BayerOrder | None = None
) -> None:
    """Check a frame against the sensor in the board profile, and its Bayer order against the calibration's.

    Raises
    ------
    FrameError
        They differ; the message names the camera, the difference and the profile's key.
    """
    for key, found, stated in (
        ("rows, sensor.columns", frame.shape, (sensor.rows, sensor.columns)),
        ("bayer_order", frame.bayer_order, _stated_order(frame, sensor)),
        ("white_level_dn", frame.white_level_dn, sensor.white_level_dn),
    ):
        if found != stated:
            raise FrameError(
                f"camera {camera_id} delivers {found} but the board profile says {stated}: check that it is the "
                f"right camera, and check sensor.{key}"
            )
    if calibrated_order not in {None, frame.bayer_order}:
        raise FrameError(
            f"camera {camera_id} delivers {frame.bayer_order} but its calibration was made with {calibrated_order}: "
            "another kernel turns the picture; run `retroscan calibrate`"
        )


def _stated_order(frame: RawFrame, sensor: SensorConfig) -> BayerOrder:
    return frame.bayer_order if sensor.bayer_order == AS_GRANTED else sensor.bayer_order


def _faults(lights: Lights) -> tuple[LightFault, ...] | None:
    """Return the driver's faults; a driver that cannot be read does not cost a confirmed frame."""
    try:
        return lights.faults()
    except LightError:
        return None
