"""An emulated sensor on USB in the simulated world: finished 8-bit pictures, JPEG, controls, plugging and unplugging.

The camera interpolates its sensor's mosaic, encodes light as sRGB and compresses. While its automatics are on, exposure
and white balance wander; the kernel's buffers keep pictures that nobody took, and fresh ones are dropped once they are
full.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Literal

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from hal.board_profile import BoardProfile
from hal.drivers.usb_hardware import usb_hardware
from hal.drivers.v4l2_stack import CONTROLS, ControlRange, Picture, StreamFormat, VideoInfo
from hal.frame import CameraSettings, RawFrame
from hal.hardware import Hardware
from hal.profile_tables import UvcConfig
from hal.simulator.bench import SimulatedScene
from hal.simulator.hardware import TwinButton
from hal.simulator.operator import TwinOperator

CARD: Final = "GelSight Mini R0B 0000-0000: Ge"
PERIOD_US: Final = 40_000.0
BUFFERS: Final = 4
JPEG_QUALITY: Final = 92
EXPOSURE_UNIT_US: Final = 100.0
GAIN_UNITS: Final = 16.0
NAMES: Final = {number: name for name, number in CONTROLS.items()}

RANGES: Final = {
    "brightness": ControlRange(-64, 64, 1),
    "white_balance_automatic": ControlRange(0, 1, 1),
    "white_balance_temperature": ControlRange(2800, 6500, 1),
    "gain": ControlRange(16, 128, 1),
    "automatic_exposure": ControlRange(0, 3, 1),
    "exposure_time": ControlRange(1, 5000, 1),
    "exposure_dynamic_framerate": ControlRange(0, 1, 1),
}
AT_POWER_ON: Final = {
    "brightness": 0,
    "white_balance_automatic": 1,
    "white_balance_temperature": 4600,
    "gain": 16,
    "automatic_exposure": 3,
    "exposure_time": 156,
    "exposure_dynamic_framerate": 1,
    "zoom": 0,
}


@dataclass(slots=True)
class VideoFaults:
    """Fault switches of the sensor on USB, set at any time.

    unplugged : the kernel has lost it
    lacks : controls that it does not have
    ignores : controls that accept a value and keep another
    stalled : it delivers nothing
    damaged : so many of its next pictures are truncated
    another_format : granted instead of the requested pixel format
    unsettled : so many pictures after streaming began are exposed for half of the time
    """

    unplugged: bool = False
    lacks: set[str] = field(default_factory=set)
    ignores: set[str] = field(default_factory=set)
    stalled: bool = False
    damaged: int = 0
    another_format: str = ""
    unsettled: int = 0


class FakeVideo:
    """See `hal.drivers.v4l2_stack.VideoStack`.

    Parameters
    ----------
    coded : the picture's data from a frame of the world; by default as the camera would code it
    """

    def __init__(
        self,
        bench: SimulatedScene,
        switched_by_zoom: bool = False,
        coded: Callable[[RawFrame, StreamFormat], bytes] | None = None,
    ) -> None:
        self.bench = bench
        self.faults = VideoFaults()
        self.controls = dict(AT_POWER_ON)
        self.others: list[VideoInfo] = []
        self.path = "/dev/video2"
        self.opened = 0
        self.switched_by_zoom = switched_by_zoom
        self.coded = coded or picture_data
        self.ranges = RANGES | ({"zoom": ControlRange(0, 4095, 1)} if switched_by_zoom else {})

    def cameras(self) -> list[VideoInfo]:
        """The attached cameras."""
        return [*self.others, *([] if self.faults.unplugged else [VideoInfo(self.path, CARD)])]

    def open(self, path: str) -> FakeVideoDevice:
        """Open the camera of this device file."""
        if self.faults.unplugged or path != self.path:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))
        return FakeVideoDevice(self)

    def unplug(self) -> None:
        """Take the sensor off its cable: every control is lost."""
        self.faults.unplugged = True

    def plug_in(self) -> None:
        """Plug it in again; the kernel gives it another device file."""
        self.faults.unplugged = False
        self.path = "/dev/video4"
        self.controls = dict(AT_POWER_ON)


class FakeVideoDevice:
    """See `hal.drivers.v4l2_stack.VideoDevice`."""

    def __init__(self, video: FakeVideo) -> None:
        self._video = video
        self._path = video.path
        self._stream = StreamFormat(0, 0, "", 0)
        self._next = 0
        self._period_ns = 1
        self._started_ns: int | None = None
        video.opened += 1

    def granted_format(self, asked: StreamFormat, frame_period_us: float) -> StreamFormat:
        """The requested pixel format at the sensor's size."""
        self._check()
        self._period_ns = round(frame_period_us * 1e3)
        sensor = self._video.bench.profile.sensor
        letters = self._video.faults.another_format or asked.pixel_format
        row_bytes = {"YUYV": 2, "RGB3": 3}.get(letters, 0) * sensor.columns
        self._stream = StreamFormat(sensor.columns, sensor.rows, letters, row_bytes)
        return self._stream

    def control_range(self, control: int) -> ControlRange | None:
        """What a control accepts."""
        self._check()
        name = NAMES[control]
        return None if name in self._video.faults.lacks else self._video.ranges.get(name)

    def read_control(self, control: int) -> int:
        """Value of a control."""
        self._check()
        return self._video.controls[self._present(control)]

    def write_control(self, control: int, value: int) -> None:
        """Set a control."""
        self._check()
        name = self._present(control)
        limits = self._video.ranges[name]
        if not limits.lowest <= value <= limits.highest:
            raise OSError(errno.ERANGE, os.strerror(errno.ERANGE))
        if name not in self._video.faults.ignores:
            self._video.controls[name] = value
        if name == "zoom":
            self._light(value)

    def start(self) -> None:
        """Start streaming."""
        self._check()
        self._started_ns = self._video.bench.clock.monotonic_ns()

    def next_picture(self, timeout_s: float) -> Picture | None:
        """The oldest waiting picture, or the next."""
        self._check()
        clock = self._video.bench.clock
        if self._started_ns is None:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        if self._video.faults.stalled:
            clock.sleep(timeout_s)
            return None
        running = (clock.monotonic_ns() - self._started_ns) // self._period_ns
        if self._next + BUFFERS < running and self._next % BUFFERS == 0:
            self._next = running  # the buffers were full: what came since is lost
        stamped_ns = self._started_ns + (self._next + 1) * self._period_ns
        wait_s = (stamped_ns - clock.monotonic_ns()) * 1e-9
        if wait_s > timeout_s:
            clock.sleep(timeout_s)
            return None
        clock.sleep(wait_s)
        self._check()
        settings = self._settings()
        if (stamped_ns - self._started_ns) // self._period_ns <= self._video.faults.unsettled:
            settings = CameraSettings(settings.exposure_us / 2.0, settings.analogue_gain)
        index, self._next = self._next, self._next + 1
        frame = self._video.bench.expose(index, stamped_ns - round(settings.exposure_us * 1e3), settings)
        data = self._video.coded(frame, self._stream)
        if self._video.faults.damaged:
            self._video.faults.damaged -= 1
            data = data[:10]
        return Picture(data, stamped_ns)

    def close(self) -> None:
        """Release the camera."""
        self._video.opened -= 1

    def _settings(self) -> CameraSettings:
        """Exposure and gain; automatic exposure wanders."""
        controls = self._video.controls
        wander = 1.0 if controls["automatic_exposure"] == 1 else 1.0 + 0.1 * (self._next % 3)
        return CameraSettings(controls["exposure_time"] * EXPOSURE_UNIT_US * wander, controls["gain"] / GAIN_UNITS)

    def _light(self, value: int) -> None:
        names = [light.name for light in self._video.bench.profile.lights]
        steps = [value >> bit & 15 for bit in (8, 4, 0)]
        self._video.bench.drive({name: float(step) for name, step in zip(names, steps, strict=True) if step})

    def _present(self, control: int) -> str:
        name = NAMES[control]
        if name in self._video.faults.lacks or name not in self._video.ranges:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        return name

    def _check(self) -> None:
        if self._video.faults.unplugged or self._path != self._video.path:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))


def picture_data(frame: RawFrame, stream: StreamFormat) -> bytes:
    """A finished picture of a raw frame, as the camera's own processor makes it."""
    span = frame.white_level_dn - frame.black_level_dn
    light = np.clip((frame.mosaic.astype(np.float32) - np.float32(frame.black_level_dn)) / span, 0.0, 1.0)
    wide = np.rint(light * 65535.0).astype(np.uint16)
    colours = cv2.cvtColor(wide, cv2.COLOR_BAYER_BG2BGR).astype(np.float32) / 65535.0
    stored = np.where(colours <= 0.0031308, 12.92 * colours, 1.055 * colours ** (1.0 / 2.4) - 0.055)
    picture = np.rint(255.0 * stored).astype(np.uint8)
    return encoded(picture, stream)


def encoded(picture: NDArray[np.uint8], stream: StreamFormat) -> bytes:
    """The data of a picture, uint8 array of shape (H, W, 3), B, G, R."""
    if stream.pixel_format == "MJPG":
        _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        return bytes(data.tobytes())
    if stream.pixel_format == "YUYV":
        return bytes(cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_YUYV).tobytes())
    return bytes(np.ascontiguousarray(picture[..., ::-1]).tobytes())


PixelFormat = Literal["MJPG", "YUYV", "RGB3"]


def uvc_profile(
    profile: BoardProfile, switched_by_zoom: bool = False, pixel_format: PixelFormat = "MJPG"
) -> BoardProfile:
    """The twin's profile as that of a sensor on USB in the same world."""
    sensor = msgspec.structs.replace(
        profile.sensor, black_level_dn=0.0, white_level_dn=65535.0, exposure_step_us=EXPOSURE_UNIT_US
    )
    uvc = UvcConfig(
        card="GelSight Mini",
        columns=sensor.columns,
        rows=sensor.rows,
        frame_period_us=PERIOD_US,
        pixel_format=pixel_format,
        fixed=("focus",),
        gain_units=GAIN_UNITS,
        white_balance_k=4600,
        lights="zoom control" if switched_by_zoom else "always on",
    )
    return msgspec.structs.replace(profile, driver="uvc", sensor=sensor, uvc=uvc)


def usb_sensor(
    bench: SimulatedScene, switched_by_zoom: bool = False, pixel_format: PixelFormat = "MJPG"
) -> tuple[Hardware, FakeVideo]:
    """A sensor on USB in the world `bench`, and what is below its drivers, to inspect and to break."""
    video = FakeVideo(bench, switched_by_zoom)
    profile = uvc_profile(bench.profile, switched_by_zoom, pixel_format)
    if not switched_by_zoom:
        bench.drive(profile.currents_ma)
    button, operator = TwinButton(bench), TwinOperator(bench)
    return usb_hardware(profile, bench.clock, video, operator=operator, button=button), video
