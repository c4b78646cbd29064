"""A libcamera pipeline through picamera2: found, configured once, streamed, closed; every failure is a sentence.

Why the small stream is "main": picamera2 needs a main stream, and a full-size one would cost 37 MB a buffer of a
12-megapixel sensor, more than a small board's contiguous memory holds. Raw is full size; main is the aiming view.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import Any, Final, TypeVar

from hal.board_parts import LibcameraFacts
from hal.board_profile import SensorFacts
from hal.errors import CameraError
from hal.frame import CameraSettings
from hal.picamera_stack import CameraStack, Job, OpenCamera, Request
from hal.raw_format import NO_RAW, RawStream, asked_format

CLOSING_S: Final = 5.0
LATE_S: Final = 1.0
"""A request that is called off while it completes is handed over within this, and then given back."""

OUT_OF_MEMORY: Final = "Cannot allocate memory"
Result = TypeVar("Result")


class CameraPipeline:
    """One camera of the stack, open or not.

    Parameters
    ----------
    load_stack : the class `Picamera2`, or what behaves like it
    """

    def __init__(self, sensor: SensorFacts, facts: LibcameraFacts, load_stack: Callable[[], CameraStack]) -> None:
        self._sensor = sensor
        self._facts = facts
        self._load_stack = load_stack
        self._camera: OpenCamera | None = None
        self._stream: RawStream | None = None
        self.camera_id = facts.camera_id

    @property
    def is_open(self) -> bool:
        """Whether it streams."""
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
            It is not there, in use, or grants something else than the profile states; it is closed again then.
        """
        stack = self._load_stack()
        number, self.camera_id = self._find(stack)
        try:
            self._camera = stack(number)
        except (RuntimeError, OSError, IndexError) as error:
            if isinstance(error.__cause__, AttributeError):  # picamera2 stumbles over a camera without raw modes
                raise CameraError(f"camera {self.camera_id} grants {NO_RAW}") from error
            raise CameraError(
                f"camera {self.camera_id} cannot be opened ({error}): check its cable, "
                "and that no other program uses it"
            ) from error
        try:
            granted = self.guarded("be configured", lambda camera: self._configured(camera, settings))
            self._stream = RawStream.granted(granted, self._sensor, self._facts)
            self.guarded("start", lambda camera: camera.start())
        except CameraError:
            self.close()
            raise

    def set_controls(self, settings: CameraSettings) -> None:
        """Ask for exposure and gain; frames show them some frames later."""
        self.guarded("take controls", lambda camera: camera.set_controls(self._controls(settings)))

    def request(self, timeout_s: float) -> Request | None:
        """The next completed request, or None when none came; one that comes too late is given back."""
        job = self.guarded("deliver a frame", lambda camera: camera.capture_request(wait=False))
        if request := self.guarded("deliver a frame", lambda _camera: _awaited(job, timeout_s)):
            return request
        self.guarded("call off a frame", lambda camera: camera.cancel_all_and_flush())
        with suppress(CancelledError):
            if late := self.guarded("call off a frame", lambda _camera: _awaited(job, LATE_S)):
                late.release()
        return None

    def guarded(self, what: str, act: Callable[[OpenCamera], Result]) -> Result:
        """What `act` returns; what picamera2 raises becomes a sentence, the kernel's own time-outs included.

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
                    f"camera {self.camera_id} finds no memory to {what}: keep dtoverlay=vc4-kms-v3d in config.txt, "
                    "which sets it aside, lower libcamera.buffer_count, or choose a smaller mode"
                ) from error
            raise CameraError(f"camera {self.camera_id} cannot {what} ({error}): check its cable and mode") from error

    def close(self) -> None:
        """Give the camera back, without waiting for ever: a torn cable can leave libcamera hanging.

        Raises
        ------
        CameraError
            It does not stop; it is forgotten all the same.
        """
        camera, self._camera, self._stream = self._camera, None, None
        if camera is None:
            return

        def give_back() -> None:
            with suppress(RuntimeError, OSError):  # a broken camera that fails to close has nothing more to lose
                camera.close()

        closing = threading.Thread(target=give_back, name="camera-close", daemon=True)
        closing.start()
        closing.join(CLOSING_S)
        if closing.is_alive():
            raise CameraError(f"camera {self.camera_id} does not stop within {CLOSING_S:g} s: switch it off and on")

    def _find(self, stack: CameraStack) -> tuple[int, str]:
        """Place in the list and name of the one camera that the profile means."""
        try:
            names = [str(info.get("Id")) for info in stack.global_camera_info()]
        except (RuntimeError, OSError, ValueError, LookupError, AttributeError) as error:
            raise CameraError(
                f"libcamera cannot list the cameras ({error}): check the ribbon cable and the sensor's overlay in "
                "config.txt, and that the user is in the group video"
            ) from error
        found = [(number, name) for number, name in enumerate(names) if self._facts.camera_id in name]
        if len(found) == 1:
            return found[0]
        there = ", ".join(names) or "none"
        problem = "is not there" if not found else "is ambiguous"
        raise CameraError(
            f"camera {self._facts.camera_id} {problem}: cameras are {there}; check the ribbon cable at both ends, "
            "the sensor's overlay in config.txt, and libcamera.camera_id in the board profile"
        )

    def _configured(self, camera: OpenCamera, settings: CameraSettings) -> Mapping[str, Any]:
        """The raw stream that was granted."""
        size = (self._sensor.columns, self._sensor.rows)
        configuration = camera.create_still_configuration(
            main={"size": (self._facts.aiming_columns, self._facts.aiming_rows), "format": "YUV420"},
            raw={"size": size, "format": asked_format(self._sensor, self._facts)},
            sensor={"output_size": size, "bit_depth": self._facts.sensor_bits},
            buffer_count=self._facts.buffer_count,
            queue=False,
            display=None,
            encode=None,
            controls=self._controls(settings),
        )
        camera.configure(configuration)
        granted: Mapping[str, Any] | None = camera.camera_configuration().get("raw")
        return granted or {}

    def _controls(self, settings: CameraSettings) -> dict[str, Any]:
        """Everything that libcamera would otherwise decide by itself."""
        period_us = round(self._facts.frame_period_us)
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
        if self._facts.lens_position is not None:
            controls |= {"AfMode": 0, "LensPosition": self._facts.lens_position}
        return controls

    def _not_started(self) -> CameraError:
        return CameraError(f"camera {self.camera_id} is not started: enter it before asking for a frame")


def _awaited(job: Job, timeout_s: float) -> Request | None:
    """The job's request, or None when it does not come in time; a time-out of the kernel's is an `OSError`."""
    try:
        return job.get_result(timeout=timeout_s)
    except TimeoutError as error:
        if error.errno is not None:
            raise
        return None
