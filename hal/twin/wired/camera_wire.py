"""A likeness of the class `Picamera2` over the bench: delayed controls, requests that hold buffers, stride, metadata.

Written after picamera2 0.3.38: what is asked for is adjusted, not refused; frames are stamped as their first row is
read out; a request that nobody releases holds its buffer, and the camera stalls when all are held.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hal.errors import CameraError, FrameTimeout
from hal.frame import CameraSettings, RawFrame
from hal.twin.bench import Bench
from hal.twin.camera import TwinCamera
from hal.twin.wired.stack_faults import StackFaults

STRIDE_BYTES: Final = 64
HANDED_OVER_S: Final = 0.002
"""How long the stack's own thread takes to hand a completed request over."""

CONTROLS: Final = frozenset(
    {
        "AeEnable",
        "AwbEnable",
        "ExposureTime",
        "AnalogueGain",
        "ColourGains",
        "FrameDurationLimits",
        "NoiseReductionMode",
        "Sharpness",
    }
)


class CameraWire:
    """See `hal.picamera_stack.CameraStack`."""

    def __init__(self, bench: Bench, camera_id: str) -> None:
        self.bench = bench
        self.camera_id = camera_id
        self.faults = StackFaults()
        self.opened = 0
        self.openings = 0
        self.held_requests = 0
        self.others: list[str] = []

    def global_camera_info(self) -> list[dict[str, Any]]:
        """The attached cameras."""
        if self.faults.unlisted:
            raise RuntimeError("failed to start camera manager: Input/output error")
        ids = self.others + ([] if self.bench.faults.camera_missing else [self.camera_id])
        return [{"Id": name, "Num": number, "Model": "imx", "Location": 2} for number, name in enumerate(ids)]

    def __call__(self, camera_num: int) -> WiredCamera:
        """The opened camera."""
        if self.faults.no_raw:
            raise RuntimeError("Camera __init__ sequence did not complete.") from AttributeError("at")
        if self.faults.in_use or self.opened:
            raise RuntimeError("Camera __init__ sequence did not complete.")
        self.opened += 1
        self.openings += 1
        return WiredCamera(self, camera_num)


class WiredCamera:
    """See `hal.picamera_stack.OpenCamera`."""

    def __init__(self, wire: CameraWire, number: int) -> None:
        self.wire = wire
        self.number = number
        self.sensor = TwinCamera(wire.bench)
        self.configuration: dict[str, Any] = {}
        self.controls: dict[str, Any] = {}
        self.jobs: list[WiredJob] = []
        self.held = 0
        self.stalled = wire.faults.stalled_openings > 0
        wire.faults.stalled_openings -= self.stalled

    def create_still_configuration(self, **configuration: Any) -> dict[str, Any]:
        """A configuration with picamera2's defaults for what is not named."""
        return {"lores": None, "buffer_count": 1, "queue": True, "controls": {}, **configuration}

    def configure(self, configuration: dict[str, Any]) -> None:
        """Grant a configuration: sizes and formats as the stack has them."""
        if self.wire.faults.no_memory:
            raise OSError(12, "Cannot allocate memory")
        self.wire.faults.check("configure")
        granted = {**configuration, "raw": dict(configuration["raw"])}
        columns, _ = granted["raw"]["size"]
        granted["raw"]["format"] = self.wire.faults.raw_format or configuration["raw"]["format"]
        granted["raw"]["stride"] = -(-2 * columns // STRIDE_BYTES) * STRIDE_BYTES
        self.configuration = granted
        self.set_controls(configuration["controls"])

    def camera_configuration(self) -> dict[str, Any]:
        """What was granted."""
        return {**self.configuration, "raw": None} if self.wire.faults.no_raw_granted else self.configuration

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        """Ask for controls; exposure and gain arrive frames later."""
        for name in controls:
            if name not in CONTROLS:
                raise RuntimeError(f"Control {name} is not advertised by libcamera")
        self.controls |= controls
        if not self.controls["AeEnable"]:
            with suppress(CameraError):  # controls of a camera that is torn off are taken all the same
                self.sensor.apply(CameraSettings(float(self.controls["ExposureTime"]), self.controls["AnalogueGain"]))

    def start(self) -> None:
        """Begin to stream."""
        self.wire.faults.check("start")
        self.sensor.__enter__()

    def capture_request(self, wait: bool) -> WiredJob:
        """A job for the next request."""
        if wait:
            raise NotImplementedError("the drivers wait with a limit of their own")
        job = WiredJob(self)
        self.jobs.append(job)
        return job

    def cancel_all_and_flush(self) -> None:
        """Call off every job that has not ended."""
        for job in self.jobs:
            job.cancelled = True
        self.jobs.clear()
        self.wire.faults.check("cancel_all_and_flush")

    def close(self) -> None:
        """Stop and release the camera."""
        self.sensor.__exit__()
        self.wire.opened -= 1
        self.wire.held_requests -= self.held


class WiredJob:
    """See `hal.picamera_stack.Job`."""

    def __init__(self, camera: WiredCamera) -> None:
        self._camera = camera
        self._late: WiredRequest | None = None
        self.cancelled = False

    def get_result(self, timeout: float | None = None) -> WiredRequest:
        """The next completed request, if a buffer is free for it."""
        if self.cancelled:
            raise CancelledError
        camera = self._camera
        wait_s = 3600.0 if timeout is None else timeout
        if self._late is not None:
            if wait_s < HANDED_OVER_S:
                raise TimeoutError
            camera.wire.bench.clock.sleep(HANDED_OVER_S)
            return self._late
        camera.wire.faults.check("get_result")
        if camera.stalled or camera.held >= camera.configuration["buffer_count"]:
            camera.wire.bench.clock.sleep(wait_s)
            raise TimeoutError
        try:
            frame = camera.sensor.next_frame(wait_s)
        except FrameTimeout as error:
            raise TimeoutError from error
        except CameraError:  # libcamera does not notice a camera that is torn off: its frames just stop
            camera.wire.bench.clock.sleep(wait_s)
            raise TimeoutError from None
        camera.jobs.remove(self)
        request = WiredRequest(camera, frame)
        if camera.wire.faults.late_requests:
            camera.wire.faults.late_requests -= 1
            self._late = request
            raise TimeoutError
        return request


class WiredRequest:
    """See `hal.picamera_stack.Request`."""

    def __init__(self, camera: WiredCamera, frame: RawFrame) -> None:
        self._camera = camera
        self._frame = frame
        self._released = False
        camera.held += 1
        camera.wire.held_requests += 1

    def get_metadata(self) -> dict[str, Any]:
        """The frame's own metadata, black levels at 16 bits."""
        granted, sensor = self._frame.granted, self._camera.wire.bench.profile.sensor
        exposure_us = round(granted.exposure_us)
        bits = int("".join(filter(str.isdigit, self._camera.configuration["raw"]["format"])))
        faults = self._camera.wire.faults
        metadata = {
            "SensorTimestamp": self._frame.sensor_timestamp_ns + exposure_us * 1000 + faults.clock_offset_ns,
            "ExposureTime": exposure_us,
            "AnalogueGain": granted.analogue_gain,
            "FrameDuration": self._camera.controls["FrameDurationLimits"][0],
            "SensorBlackLevels": (round(sensor.black_level_dn * 2 ** (16 - bits)),) * 4,
            "ColourGains": (1.0, 1.0),
            "Lux": 400.0,
        }
        metadata.pop(faults.without, None)
        return metadata

    def make_array(self, name: str) -> NDArray[np.uint8]:
        """A copy of a buffer: raw bytes with the stride's padding, or planar YUV."""
        if self._released:
            raise RuntimeError("the request was released")
        if self._camera.wire.faults.unmappable:
            raise ValueError("cannot reshape array of size 0 into shape (272,768)")
        if name == "raw":
            return self._raw()
        columns, rows = self._camera.configuration["main"]["size"]
        stride = -(-columns // STRIDE_BYTES) * STRIDE_BYTES
        picture = np.full((rows * 3 // 2, stride), 128, np.uint8)
        height, width = self._frame.shape
        # As libcamera has it: a picture of other proportions shows the middle of the field and loses what is beside.
        shown = min(height / rows, width / columns)
        top, left = (height - shown * rows) / 2.0, (width - shown * columns) / 2.0
        at = (np.arange(size) * shown + first for size, first in ((rows, top), (columns, left)))
        grey = self._frame.mosaic[np.ix_(*(places.astype(int) for places in at))]
        picture[:rows, :columns] = np.clip(grey * (255.0 / self._frame.white_level_dn), 0.0, 255.0)
        return picture

    def release(self) -> None:
        """Give the buffers back."""
        if not self._released:
            self._released = True
            self._camera.held -= 1
            self._camera.wire.held_requests -= 1

    def _raw(self) -> NDArray[np.uint8]:
        stride = self._camera.configuration["raw"]["stride"]
        rows, columns = self._frame.shape
        padded = np.full((rows, stride), 0xAA, np.uint8)
        padded[:, : 2 * columns] = self._frame.mosaic.view(np.uint8)
        return padded[: rows - self._camera.wire.faults.rows_lost]
