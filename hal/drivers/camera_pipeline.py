"""A libcamera pipeline through picamera2: found, configured once, streamed, closed; every failure is one sentence.

The small stream is "main" because picamera2 needs a main stream, and a full-size one would take 37 MB per buffer of a
12-megapixel sensor, more than the contiguous memory of a small board. Raw has full size; main is the aiming view.

The raw stream that a camera granted: unpacked and as the profile states, or refused with the reason.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from hal.board_profile import LibcameraConfig, SensorConfig
from hal.drivers.picamera_stack import CameraStack, Job, OpenCamera, Request
from hal.errors import CameraError, CameraStuck
from hal.frame import AS_GRANTED, BayerOrder, CameraSettings

_UNPACKED: Final = re.compile(r"S(RGGB|BGGR|GRBG|GBRG)(8|10|12|14|16)")
_ANY_ORDER: Final[BayerOrder] = "RGGB"
"""libcamera adjusts a raw format of another order than the sensor's to the sensor's."""

_METADATA_BITS: Final = 16
"""libcamera states black levels at this number of bits for every sensor."""


NO_RAW: Final = "no raw stream, as a USB or virtual camera: use a sensor on the board's own connector"


def requested_format(sensor: SensorConfig, config: LibcameraConfig) -> str:
    """libcamera's name of the unpacked format in the profile, such as "SRGGB12"; any order if as granted."""
    order = _ANY_ORDER if sensor.bayer_order == AS_GRANTED else sensor.bayer_order
    return f"S{order}{config.raw_bits}"


@dataclass(frozen=True, slots=True)
class RawStream:
    """The granted raw stream: size in pixels, stride in bytes, and how to read its counts."""

    rows: int
    columns: int
    stride: int
    bits: int
    bayer_order: BayerOrder

    @classmethod
    def granted(cls, stream: Mapping[str, Any], sensor: SensorConfig, config: LibcameraConfig) -> RawStream:
        """Return the stream of a camera configuration, checked against the profile.

        Raises
        ------
        CameraError
            It is compressed or packed, or differs from the profile in size, bits or a stated Bayer order.
        """
        if not stream:
            raise CameraError(f"the camera grants {NO_RAW}")
        name = str(stream["format"])
        if "PISP_COMP" in name:
            raise CameraError(
                f"the camera grants {name}, which loses counts: ask for an unpacked format (libcamera.raw_bits = 16)"
            )
        if name.endswith("_CSI2P"):
            raise CameraError(f"the camera grants the packed format {name}: set libcamera.raw_bits to an unpacked one")
        match = _UNPACKED.fullmatch(name)
        if match is None:
            raise CameraError(
                f"the camera grants {name}, which is not a raw colour format: check libcamera.camera_id and its cable"
            )
        columns, rows = stream["size"]
        order, bits = cast(BayerOrder, match[1]), int(match[2])
        for key, found, stated in (
            ("sensor.bayer_order", order, order if sensor.bayer_order == AS_GRANTED else sensor.bayer_order),
            ("libcamera.raw_bits", bits, config.raw_bits),
            ("sensor.columns, sensor.rows", (columns, rows), (sensor.columns, sensor.rows)),
        ):
            if found != stated:
                also = ', or say "as granted"' if key == "sensor.bayer_order" else ""
                raise CameraError(f"the camera grants {found} but the board profile says {stated}: correct {key}{also}")
        return cls(rows, columns, int(stream["stride"]), bits, order)

    def mosaic(self, buffer: NDArray[np.uint8]) -> NDArray[np.uint16]:
        """Return counts without the padding of the stride, uint16 array (H, W), from bytes of shape (H, stride).

        Raises
        ------
        CameraError
            The frame has another size than was granted.
        """
        if buffer.shape != (self.rows, self.stride):
            raise CameraError(
                f"the camera delivers {buffer.shape[0]} rows of {buffer.shape[-1]} bytes where it granted "
                f"{self.rows} of {self.stride}: restart it"
            )
        if self.bits == 8:
            return buffer[:, : self.columns].astype(np.uint16)
        return np.ascontiguousarray(buffer.view(np.uint16)[:, : self.columns])

    def black_level_dn(self, metadata: Mapping[str, Any]) -> float:
        """Return the mean black level from a frame's metadata, in counts of this stream.

        Raises
        ------
        CameraError
            The metadata has none.
        """
        levels = metadata.get("SensorBlackLevels")
        if not levels:
            raise CameraError("the frame's metadata has no SensorBlackLevels: the camera's tuning file is missing")
        return float(np.mean(levels)) / 2.0 ** (_METADATA_BITS - self.bits)


CLOSING_S: Final = 5.0
LATE_S: Final = 1.0
"""A request that completes while it is cancelled is waited for this long, and then released."""

OUT_OF_MEMORY: Final = "Cannot allocate memory"
Result = TypeVar("Result")


class CameraPipeline:
    """One camera of the stack, open or not.

    Parameters
    ----------
    load_stack : returns the class `Picamera2`, or an emulated one
    """

    def __init__(self, sensor: SensorConfig, config: LibcameraConfig, load_stack: Callable[[], CameraStack]) -> None:
        self._sensor = sensor
        self._config = config
        self._load_stack = load_stack
        self._camera: OpenCamera | None = None
        self._stream: RawStream | None = None
        self._closing: list[threading.Thread] = []
        self.camera_id = config.camera_id

    @property
    def is_open(self) -> bool:
        """True if it streams."""
        return self._camera is not None

    @property
    def stream(self) -> RawStream:
        """The granted raw stream."""
        if self._stream is None:
            raise self._not_started()
        return self._stream

    def open(self, settings: CameraSettings) -> None:
        """Find, configure and start the camera, with every control set before the first frame.

        Raises
        ------
        CameraError
            It is absent, in use, or grants other settings than the profile states; it is closed again then.
        CameraStuck
            This process itself still holds it, as it did not close.
        """
        stack = self._load_stack()
        number, self.camera_id = self._find(stack)
        try:
            self._camera = stack(number)
        except (RuntimeError, OSError, IndexError) as error:
            if self._still_closing():
                raise self._held() from error
            if isinstance(error.__cause__, AttributeError):  # how picamera2 fails on a camera without raw modes
                raise CameraError(f"camera {self.camera_id} grants {NO_RAW}") from error
            raise CameraError(
                f"camera {self.camera_id} cannot be opened ({error}): check its cable, "
                "and that no other program uses it"
            ) from error
        try:
            granted = self.guarded("be configured", lambda camera: self._configured(camera, settings))
            self._stream = RawStream.granted(granted, self._sensor, self._config)
            self.guarded("start", lambda camera: camera.start())
        except CameraError:
            self.close()
            raise

    def set_controls(self, settings: CameraSettings) -> None:
        """Request exposure and gain; they act some frames later."""
        self.guarded("take controls", lambda camera: camera.set_controls(self._controls(settings)))

    def request(self, timeout_s: float) -> Request | None:
        """Return the next completed request, or None; one that comes too late is released."""
        job = self.guarded("deliver a frame", lambda camera: camera.capture_request(wait=False))
        if request := self.guarded("deliver a frame", lambda _camera: _awaited(job, timeout_s)):
            return request
        self.guarded("cancel a frame", lambda camera: camera.cancel_all_and_flush())
        with suppress(CancelledError):
            if late := self.guarded("cancel a frame", lambda _camera: _awaited(job, LATE_S)):
                late.release()
        return None

    def guarded(self, what: str, act: Callable[[OpenCamera], Result]) -> Result:
        """Return the result of `act`; errors of picamera2, including time-outs of the kernel, become one sentence.

        Raises
        ------
        CameraError
            Names the camera, `what` it cannot do, and what to check.
        """
        if self._camera is None:
            raise self._not_started()
        try:
            return act(self._camera)
        except CameraError:
            raise
        except (RuntimeError, OSError, ValueError, LookupError) as error:
            if OUT_OF_MEMORY in str(error):
                raise CameraError(
                    f"camera {self.camera_id} has no memory to {what}: keep dtoverlay=vc4-kms-v3d in config.txt, "
                    "which reserves it, lower libcamera.buffer_count, or choose a smaller mode"
                ) from error
            raise CameraError(f"camera {self.camera_id} cannot {what} ({error}): check its cable and mode") from error

    def close(self) -> None:
        """Release the camera within a time limit: libcamera can hang after a broken cable.

        Raises
        ------
        CameraError
            It does not stop; it is dropped anyway.
        CameraStuck
            It is the second that does not stop.
        """
        camera, self._camera, self._stream = self._camera, None, None
        if camera is None:
            return

        def release() -> None:
            with suppress(RuntimeError, OSError):  # a broken camera may fail to close
                camera.close()

        closing = threading.Thread(target=release, name="camera-close", daemon=True)
        closing.start()
        closing.join(CLOSING_S)
        if closing.is_alive():
            self._closing.append(closing)
            if self._still_closing() > 1:
                raise self._held()
            raise CameraError(f"camera {self.camera_id} does not stop within {CLOSING_S:g} s: power-cycle it")

    def _still_closing(self) -> int:
        """Return how many cameras hang in being closed."""
        self._closing = [thread for thread in self._closing if thread.is_alive()]
        return len(self._closing)

    def _held(self) -> CameraStuck:
        return CameraStuck(
            f"camera {self.camera_id} did not stop and is still held by this program: start the program again; "
            "if it happens again, check the ribbon cable and power-cycle the camera"
        )

    def _find(self, stack: CameraStack) -> tuple[int, str]:
        """Return the index and name of the one camera that the profile names."""
        try:
            names = [str(info.get("Id")) for info in stack.global_camera_info()]
        except (RuntimeError, OSError, ValueError, LookupError, AttributeError) as error:
            raise CameraError(
                f"libcamera cannot list the cameras ({error}): check the ribbon cable and the sensor's overlay in "
                "config.txt, and that the user is in the group video"
            ) from error
        found = [(number, name) for number, name in enumerate(names) if self._config.camera_id in name]
        if len(found) == 1:
            return found[0]
        there = ", ".join(names) or "none"
        problem = "is not there" if not found else "is ambiguous"
        raise CameraError(
            f"camera {self._config.camera_id} {problem}: cameras are {there}; check the ribbon cable at both ends, "
            "the sensor's overlay in config.txt, and libcamera.camera_id in the board profile"
        )

    def _configured(self, camera: OpenCamera, settings: CameraSettings) -> Mapping[str, Any]:
        """Return the granted raw stream."""
        size = (self._sensor.columns, self._sensor.rows)
        configuration = camera.create_still_configuration(
            main={"size": (self._config.aiming_columns, self._config.aiming_rows), "format": "YUV420"},
            raw={"size": size, "format": requested_format(self._sensor, self._config)},
            sensor={"output_size": size, "bit_depth": self._config.sensor_bits},
            buffer_count=self._config.buffer_count,
            queue=False,
            display=None,
            encode=None,
            controls=self._controls(settings),
        )
        camera.configure(configuration)
        granted: Mapping[str, Any] | None = camera.camera_configuration().get("raw")
        return granted or {}

    def _controls(self, settings: CameraSettings) -> dict[str, Any]:
        """Return all controls that libcamera would otherwise choose by itself."""
        period_us = round(self._config.frame_period_us)
        controls: dict[str, Any] = {
            "AeEnable": False,
            "AwbEnable": False,
            "ExposureTime": round(settings.exposure_us),
            "AnalogueGain": settings.analogue_gain,
            "ColourGains": (1.0, 1.0),
            "FrameDurationLimits": (period_us, period_us),
            "NoiseReductionMode": 0,
            "Sharpness": 0.0,
        }
        if self._config.lens_position is not None:
            controls |= {"AfMode": 0, "LensPosition": self._config.lens_position}
        return controls

    def _not_started(self) -> CameraError:
        return CameraError(f"camera {self.camera_id} is not started: enter it before asking for a frame")


def _awaited(job: Job, timeout_s: float) -> Request | None:
    """Return the job's request, or None when it does not come in time; a time-out of the kernel is an `OSError`."""
    try:
        return job.get_result(timeout=timeout_s)
    except TimeoutError as error:
        if error.errno is not None:
            raise
        return None
