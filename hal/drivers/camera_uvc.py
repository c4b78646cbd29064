"""A camera on USB through the kernel's video interface: everything automatic is off, which every frame proves again.

A camera that was unplugged or has stalled is said so, and looked for again by the next call, under whatever device file
the kernel gives it then. Frames of the time in which a camera settles after it was opened are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from hal.board_profile import SensorConfig
from hal.drivers.uvc_choice import ChosenCamera
from hal.drivers.uvc_controls import LockedControls
from hal.drivers.uvc_pixels import aiming_picture, decoded, mosaic_of
from hal.drivers.v4l2_stack import StreamFormat, VideoDevice
from hal.errors import CameraError, FrameTimeout
from hal.frame import CameraSettings, RawFrame
from hal.interfaces import Clock
from hal.uvc_table import UvcConfig

STALLED_S: Final = 1.0
Result = TypeVar("Result")


class UvcCamera:
    """See `hal.interfaces.Camera`.

    Parameters
    ----------
    settings : initial exposure and gain
    chosen : which of the machine's cameras
    """

    def __init__(
        self, sensor: SensorConfig, config: UvcConfig, settings: CameraSettings, chosen: ChosenCamera, clock: Clock
    ) -> None:
        self._sensor = sensor
        self._config = config
        self._initial = self._requested = settings
        self._chosen = chosen
        self._clock = clock
        self._device: VideoDevice | None = None
        self._controls: LockedControls | None = None
        self._stream = StreamFormat(config.columns, config.rows, config.pixel_format, 0)
        self._granted = self._previous = settings
        self._takes_effect_ns = self._settled_ns = 0
        self._entered = False
        self._waited_s = 0.0
        self._kept: dict[str, int] = {}

    @property
    def camera_id(self) -> str:
        """The kernel's name of the camera and its serial number; before it is first opened, the part in the profile."""
        return self._chosen.name

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every raw frame."""
        return self._sensor.rows, self._sensor.columns

    def apply(self, settings: CameraSettings) -> None:
        """Set exposure and gain and read them back; frames show them some frames later.

        Raises
        ------
        CameraError
            The camera does not keep them, or one that had disappeared is still absent.
        """
        self._requested = settings
        if not self._reopened():
            self._guarded(self._lock)

    def next_frame(self, timeout_s: float) -> RawFrame:
        """The next frame that ends after now.

        Raises
        ------
        FrameTimeout
            It came too late.
        CameraError
            The camera is gone or not started, or does not keep what was locked.
        """
        picture, began_ns, granted = self._next(timeout_s)
        return RawFrame(
            mosaic=mosaic_of(picture, self._config.encoding),
            bayer_order="RGGB",
            black_level_dn=self._sensor.black_level_dn,
            white_level_dn=self._sensor.white_level_dn,
            granted=granted,
            sensor_timestamp_ns=began_ns,
        )

    def aiming_view(self, timeout_s: float) -> NDArray[np.uint8]:
        """The next small grey picture, uint8 array of shape (H / 8, W / 8). Errors as for `next_frame`."""
        return aiming_picture(self._next(timeout_s)[0])

    def __enter__(self) -> Self:
        self._entered = True
        try:
            self._open()
        except CameraError:
            self._entered = False
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        self._entered = False
        self._close()

    def _open(self) -> None:
        """Find, lock and start the camera."""
        with self._one_sentence():
            self._device = self._chosen.open()
            config = self._config
            asked = StreamFormat(config.columns, config.rows, config.pixel_format, 0)
            self._stream = self._device.granted_format(asked, config.frame_period_us)
            self._check_format(asked)
            self._controls = LockedControls(self._device, self.camera_id, self._initial, config, self._kept)
            self._lock()
            self._device.start()
        self._settled_ns = self._clock.monotonic_ns() + self._settling_ns
        self._waited_s = 0.0

    def _check_format(self, asked: StreamFormat) -> None:
        granted = self._stream
        if (granted.columns, granted.rows, granted.pixel_format) != (asked.columns, asked.rows, asked.pixel_format):
            raise CameraError(
                f"camera {self.camera_id} grants {granted.pixel_format} of {granted.columns}x{granted.rows} where the "
                f"board profile asks for {asked.pixel_format} of {asked.columns}x{asked.rows}: correct uvc.columns, "
                "uvc.rows and uvc.pixel_format"
            )

    def _lock(self) -> None:
        if self._controls is None:
            raise self._not_started()
        granted = self._controls.lock(self._requested)
        now_ns = self._clock.monotonic_ns()
        if granted != self._granted:
            self._previous = self._granted
            self._granted = granted
            self._takes_effect_ns = now_ns + self._settling_ns

    @property
    def _settling_ns(self) -> int:
        return round(self._config.settle_frames * self._config.frame_period_us * 1e3)

    def _reopened(self) -> bool:
        """Open an entered camera that was lost or has stalled; returns whether that was needed."""
        if not self._entered:
            raise self._not_started()
        if self._device is not None and self._waited_s < STALLED_S:
            return False
        self._close()
        self._open()
        return True

    def _next(self, timeout_s: float) -> tuple[NDArray[np.uint8], int, CameraSettings]:
        """The next frame's part of the picture (B, G, R), when its exposure began (ns), and its settings."""
        self._reopened()
        asked_ns = max(self._clock.monotonic_ns(), self._settled_ns)
        end_ns = asked_ns + round(timeout_s * 1e9)
        while (left_ns := end_ns - self._clock.monotonic_ns()) > 0:
            picture = self._guarded(lambda left_s=left_ns * 1e-9: self._opened().next_picture(left_s))  # type: ignore[misc]
            if picture is None or picture.stamped_ns < asked_ns:
                continue
            pixels = decoded(picture.data, self._stream)
            if pixels is None:
                continue
            self._guarded(self._prove)
            self._waited_s = 0.0
            granted = self._granted if picture.stamped_ns >= self._takes_effect_ns else self._previous
            # The stamp is of the first data, sent after the exposure of the first row.
            began_ns = picture.stamped_ns - round(granted.exposure_us * 1e3)
            top, left = self._config.top, self._config.left
            inside = pixels[top : top + self._sensor.rows, left : left + self._sensor.columns]
            return np.ascontiguousarray(inside), began_ns, granted
        self._waited_s += timeout_s
        raise FrameTimeout(
            f"camera {self.camera_id} delivered no whole frame within {timeout_s:g} s: check its cable, use a USB port "
            "of its own, and end other programs that use it"
        )

    def _prove(self) -> None:
        if self._controls is not None:
            self._controls.prove()

    def _opened(self) -> VideoDevice:
        if self._device is None:
            raise self._not_started()
        return self._device

    def _guarded(self, act: Callable[[], Result]) -> Result:
        """Result of `act`; a camera that the kernel lost is closed, so that the next call opens it again."""
        with self._one_sentence():
            return act()

    @contextmanager
    def _one_sentence(self) -> Iterator[None]:
        try:
            yield
        except CameraError:
            self._close()
            raise
        except OSError as error:
            self._close()
            raise CameraError(
                f"camera {self.camera_id} does not answer ({error.strerror or error}): plug it in again; it is opened "
                "by the next press"
            ) from error

    def _close(self) -> None:
        device, self._device, self._controls = self._device, None, None
        if device is not None:
            device.close()

    def _not_started(self) -> CameraError:
        return CameraError(f"camera {self.camera_id} is not started: enter it before asking for a frame")
