"""An emulated class `Picamera2`: delayed controls, requests that hold buffers, stride, metadata.

Follows picamera2 0.3.38: requested settings are adjusted, not refused; frames are stamped when their first row is read
out; an unreleased request holds its buffer, and the camera stalls when all are held.
"""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hal.errors import CameraError, FrameTimeout
from hal.frame import CameraSettings, RawFrame
from hal.simulator.bench import SimulatedScene
from hal.simulator.camera import TwinCamera

STRIDE_BYTES: Final = 64


HANDOVER_S: Final = 0.002
"""Time that the stack's own thread takes to hand over a completed request."""


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


@dataclass(slots=True)
class StackFaults:
    """Fault switches of the camera stack, set at any time; those of the sensor are in the simulated world.

    no_memory : the kernel has no contiguous memory when the camera is configured
    in_use : another program uses the camera
    raw_format : the granted format, whatever was requested
    no_raw : the camera has no raw modes, like libcamera's virtual one; picamera2 fails when opening it
    no_raw_granted : no raw stream is granted
    rows_lost : rows missing at the end of every raw buffer
    stalled_openings : number of openings after which the camera delivers nothing
    unmappable : buffers cannot be mapped
    without : a key missing from the metadata
    clock_offset_ns : frames are stamped by another clock, this much ahead
    unlisted : libcamera cannot list the cameras
    timed_out : a call that fails with "connection timed out", such as "configure"
    hanging_closings : number of cameras that are not released before `FakePicamera2.let_go` is set
    late_requests : number of requests that complete during cancellation and are handed over afterwards
    """

    no_memory: bool = False
    in_use: bool = False
    raw_format: str = ""
    no_raw: bool = False
    no_raw_granted: bool = False
    rows_lost: int = 0
    stalled_openings: int = 0
    unmappable: bool = False
    without: str = ""
    clock_offset_ns: int = 0
    unlisted: bool = False
    timed_out: str = ""
    hanging_closings: int = 0
    late_requests: int = 0

    def check(self, call: str) -> None:
        """Fail like the kernel after a time-out."""
        if self.timed_out == call:
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))


class FakePicamera2:
    """See `hal.drivers.picamera_stack.CameraStack`."""

    def __init__(self, bench: SimulatedScene, camera_id: str) -> None:
        self.bench = bench
        self.camera_id = camera_id
        self.faults = StackFaults()
        self.opened = 0
        self.openings = 0
        self.held_requests = 0
        self.others: list[str] = []
        self.let_go = threading.Event()

    def global_camera_info(self) -> list[dict[str, Any]]:
        """The attached cameras."""
        if self.faults.unlisted:
            raise RuntimeError("failed to start camera manager: Input/output error")
        ids = self.others + ([] if self.bench.faults.camera_missing else [self.camera_id])
        return [{"Id": name, "Num": number, "Model": "imx", "Location": 2} for number, name in enumerate(ids)]

    def __call__(self, camera_num: int) -> FakeCamera:
        """Open a camera."""
        if self.faults.no_raw:
            raise RuntimeError("Camera __init__ sequence did not complete.") from AttributeError("at")
        if self.faults.in_use or self.opened:
            raise RuntimeError("Camera __init__ sequence did not complete.")
        self.opened += 1
        self.openings += 1
        return FakeCamera(self, camera_num)


class FakeCamera:
    """See `hal.drivers.picamera_stack.OpenCamera`."""

    def __init__(self, wire: FakePicamera2, number: int) -> None:
        self.wire = wire
        self.number = number
        self.sensor = TwinCamera(wire.bench)
        self.configuration: dict[str, Any] = {}
        self.controls: dict[str, Any] = {}
        self.jobs: list[FakeJob] = []
        self.held = 0
        self.stalled = wire.faults.stalled_openings > 0
        wire.faults.stalled_openings -= self.stalled

    def create_still_configuration(self, **configuration: Any) -> dict[str, Any]:
        """A configuration with picamera2's defaults for missing entries."""
        return {"lores": None, "buffer_count": 1, "queue": True, "controls": {}, **configuration}

    def configure(self, configuration: dict[str, Any]) -> None:
        """Grant a configuration, with the sizes and formats of the stack."""
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
        """Granted configuration."""
        return {**self.configuration, "raw": None} if self.wire.faults.no_raw_granted else self.configuration

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        """Request controls; exposure and gain act some frames later."""
        for name in controls:
            if name not in CONTROLS:
                raise RuntimeError(f"Control {name} is not advertised by libcamera")
        self.controls |= controls
        if not self.controls["AeEnable"]:
            with suppress(CameraError):  # an unplugged camera still accepts controls
                self.sensor.apply(CameraSettings(float(self.controls["ExposureTime"]), self.controls["AnalogueGain"]))

    def start(self) -> None:
        """Start streaming."""
        self.wire.faults.check("start")
        self.sensor.__enter__()

    def capture_request(self, wait: bool) -> FakeJob:
        """A job for the next request."""
        if wait:
            raise NotImplementedError("the drivers use their own time limit")
        job = FakeJob(self)
        self.jobs.append(job)
        return job

    def cancel_all_and_flush(self) -> None:
        """Cancel every pending job."""
        for job in self.jobs:
            job.cancelled = True
        self.jobs.clear()
        self.wire.faults.check("cancel_all_and_flush")

    def close(self) -> None:
        """Stop and release the camera."""
        if self.wire.faults.hanging_closings:
            self.wire.faults.hanging_closings -= 1
            self.wire.let_go.wait()
        self.sensor.__exit__()
        self.wire.opened -= 1
        self.wire.held_requests -= self.held


class FakeJob:
    """See `hal.drivers.picamera_stack.Job`."""

    def __init__(self, camera: FakeCamera) -> None:
        self._camera = camera
        self._late: FakeRequest | None = None
        self.cancelled = False

    def get_result(self, timeout: float | None = None) -> FakeRequest:
        """The next completed request, if a buffer is free for it."""
        if self.cancelled:
            raise CancelledError
        camera = self._camera
        wait_s = 3600.0 if timeout is None else timeout
        if self._late is not None:
            if wait_s < HANDOVER_S:
                raise TimeoutError
            camera.wire.bench.clock.sleep(HANDOVER_S)
            return self._late
        camera.wire.faults.check("get_result")
        if camera.stalled or camera.held >= camera.configuration["buffer_count"]:
            camera.wire.bench.clock.sleep(wait_s)
            raise TimeoutError
        try:
            frame = camera.sensor.next_frame(wait_s)
        except FrameTimeout as error:
            raise TimeoutError from error
        except CameraError:  # libcamera does not detect an unplugged camera: frames just stop
            camera.wire.bench.clock.sleep(wait_s)
            raise TimeoutError from None
        camera.jobs.remove(self)
        request = FakeRequest(camera, frame)
        if camera.wire.faults.late_requests:
            camera.wire.faults.late_requests -= 1
            self._late = request
            raise TimeoutError
        return request


class FakeRequest:
    """See `hal.drivers.picamera_stack.Request`."""

    def __init__(self, camera: FakeCamera, frame: RawFrame) -> None:
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
        # Like libcamera: a picture of another aspect ratio is cropped to the middle of the field.
        shown = min(height / rows, width / columns)
        top, left = (height - shown * rows) / 2.0, (width - shown * columns) / 2.0
        at = (np.arange(size) * shown + first for size, first in ((rows, top), (columns, left)))
        grey = self._frame.mosaic[np.ix_(*(places.astype(int) for places in at))]
        picture[:rows, :columns] = np.clip(grey * (255.0 / self._frame.white_level_dn), 0.0, 255.0)
        return picture

    def release(self) -> None:
        """Return the buffers."""
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
