"""A libcamera camera through picamera2: all automatics off, every frame read with its own metadata.

A stalled pipeline is not reopened at once: that takes seconds, and the caller may have switched lights on. The stall is
reported, and the next call reopens the pipeline, which the caller can make with lights off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from hal.board_profile import LibcameraConfig, SensorConfig
from hal.drivers.camera_pipeline import CameraPipeline
from hal.drivers.picamera_stack import CameraStack, OpenCamera, Request
from hal.errors import CameraError, FrameTimeout
from hal.frame import CameraSettings, RawFrame
from hal.interfaces import Clock

MAX_FRAME_AGE_S: Final = 30.0
"""A frame that seems older than this, or in the future, was stamped by another clock."""

STALLED_S: Final = 0.5
STALLED_PERIODS: Final = 5
"""A pipeline without a frame for this long, in seconds and in frame periods, has stalled."""

Result = TypeVar("Result")


class PicameraCamera:
    """See `hal.interfaces.Camera`.

    Parameters
    ----------
    settings : initial exposure and gain
    load_stack : returns the class `Picamera2`, or an emulated one
    """

    def __init__(
        self,
        sensor: SensorConfig,
        config: LibcameraConfig,
        settings: CameraSettings,
        load_stack: Callable[[], CameraStack],
        clock: Clock,
    ) -> None:
        self._sensor = sensor
        self._config = config
        self._requested = settings
        self._pipeline = CameraPipeline(sensor, config, load_stack)
        self._clock = clock
        self._entered = False
        self._waited_s = 0.0

    @property
    def camera_id(self) -> str:
        """libcamera's name of the camera; before it is first opened, the part of it in the profile."""
        return self._pipeline.camera_id

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every raw frame, in sensor pixels."""
        return self._sensor.rows, self._sensor.columns

    def apply(self, settings: CameraSettings) -> None:
        """Request exposure and gain; they act some frames later, or from the first frame after reopening.

        Raises
        ------
        CameraError
            A camera that had stalled or disappeared cannot be opened again.
        """
        self._requested = settings
        if self._pipeline.is_open and not self._stalled:
            self._pipeline.set_controls(settings)
        self._reopen_if_stalled()

    def next_frame(self, timeout_s: float) -> RawFrame:
        """Return the next raw frame whose read-out ends after now.

        Raises
        ------
        FrameTimeout
            It came too late. A stalled pipeline is reopened by the next call.
        CameraError
            The camera disappeared, is not started, or delivers another format than it granted.
        """
        return self._next(timeout_s, self._raw_frame)

    def aiming_view(self, timeout_s: float) -> NDArray[np.uint8]:
        """Return the next small grey picture, uint8 array of shape (h, w): luma of the small stream."""
        rows, columns = self._config.aiming_rows, self._config.aiming_columns

        def luma(request: Request, _metadata: Mapping[str, Any]) -> NDArray[np.uint8]:
            return np.ascontiguousarray(request.make_array("main")[:rows, :columns])

        return self._next(timeout_s, luma)

    def __enter__(self) -> Self:
        self._pipeline.open(self._requested)
        self._entered, self._waited_s = True, 0.0
        return self

    def __exit__(self, *exc: object) -> None:
        self._entered = False
        self._pipeline.close()

    @property
    def _stalled(self) -> bool:
        return self._waited_s >= max(STALLED_S, STALLED_PERIODS * self._config.frame_period_us * 1e-6)

    def _reopen_if_stalled(self) -> None:
        """Reopen an entered camera that has stalled or disappeared."""
        if self._entered and (self._stalled or not self._pipeline.is_open):
            self._waited_s = 0.0
            self._pipeline.close()
            self._pipeline.open(self._requested)

    def _next(self, timeout_s: float, read: Callable[[Request, Mapping[str, Any]], Result]) -> Result:
        """Return the result of `read` for the next frame that ends after now."""
        self._reopen_if_stalled()
        asked_ns = alive_ns = self._clock.monotonic_ns()
        end_ns = asked_ns + round(timeout_s * 1e9)
        while (left_ns := end_ns - self._clock.monotonic_ns()) > 0:
            try:
                request = self._pipeline.request(left_ns * 1e-9)
            except CameraError:
                self._waited_s = math.inf  # reopening releases what it still holds
                raise
            if request is None:
                break
            self._waited_s, alive_ns = 0.0, self._clock.monotonic_ns()
            if (result := self._read(request, asked_ns, read)) is not None:
                return result
        self._waited_s += (self._clock.monotonic_ns() - alive_ns) * 1e-9
        raise FrameTimeout(
            f"camera {self.camera_id} delivered no frame within {timeout_s:g} s: check its ribbon cable at both ends "
            "and its supply"
        )

    def _read(
        self, request: Request, asked_ns: int, read: Callable[[Request, Mapping[str, Any]], Result]
    ) -> Result | None:
        """Return the result of `read` and release the request; None if its frame ended before `asked_ns`."""

        def unpack(_camera: OpenCamera) -> Result | None:
            metadata = request.get_metadata()
            return read(request, metadata) if self._ended_ns(metadata) >= asked_ns else None

        try:
            return self._pipeline.guarded("deliver a frame", unpack)
        finally:
            request.release()

    def _raw_frame(self, request: Request, metadata: Mapping[str, Any]) -> RawFrame:
        """Return the request's frame, stamped with the start of its exposure.

        libcamera stamps the read-out of the first row, one exposure time later.
        """
        stream = self._pipeline.stream
        exposure_us = float(self._metadata_value(metadata, "ExposureTime"))
        return RawFrame(
            mosaic=stream.mosaic(request.make_array("raw")),
            bayer_order=stream.bayer_order,
            black_level_dn=stream.black_level_dn(metadata),
            white_level_dn=self._sensor.white_level_dn,
            granted=CameraSettings(exposure_us, float(self._metadata_value(metadata, "AnalogueGain"))),
            sensor_timestamp_ns=int(self._metadata_value(metadata, "SensorTimestamp")) - round(exposure_us * 1e3),
        )

    def _ended_ns(self, metadata: Mapping[str, Any]) -> int:
        """Return when a frame's read-out ended, within a frame period."""
        stamped_ns = int(self._metadata_value(metadata, "SensorTimestamp"))
        age_s = (self._clock.monotonic_ns() - stamped_ns) * 1e-9
        if not -0.001 <= age_s <= MAX_FRAME_AGE_S:
            raise CameraError(
                f"camera {self.camera_id} stamps its frames {age_s:.3f} s ago, which is not the monotonic clock: "
                "their light cannot be confirmed; update libcamera"
            )
        return stamped_ns + round(float(metadata.get("FrameDuration", self._config.frame_period_us)) * 1e3)

    def _metadata_value(self, metadata: Mapping[str, Any], key: str) -> Any:
        if key not in metadata:
            raise CameraError(f"camera {self.camera_id} delivers frames without {key}: update libcamera")
        return metadata[key]
