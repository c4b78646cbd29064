"""A camera on USB through the kernel's video interface: everything automatic is off, which every frame proves again.

A camera that was unplugged or has stalled is said so, and looked for again by the next call, under whatever device file
the kernel gives it then. Frames of the time in which a camera settles after it was opened are dropped.

From a finished 8-bit picture to the raw frame's mosaic.

The sensor measured one colour a pixel and the camera interpolated the other two, so a picture holds three values where
one was measured. Here each pixel keeps one again: the mean of that colour over the pixel and its neighbours, by 1 2 1
along rows and columns. That takes together what interpolation spread over neighbours, and each colour stays where it
was seen: a mean of 2x2 pixels would shift red against blue by a pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Final, Literal, Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from hal.board_profile import SensorConfig
from hal.drivers.uvc_controls import LockedControls
from hal.drivers.v4l2_stack import StreamFormat, VideoDevice, VideoInfo, VideoStack
from hal.errors import CameraError, FrameTimeout
from hal.frame import CameraSettings, RawFrame
from hal.interfaces import Clock
from hal.profile_tables import UvcConfig

WHITE_DN: Final = 65535
CLIPPED_FROM: Final = 253
"""Stored value from which a pixel counts as saturated: a mean that holds one would hide it."""

AIMING_STEP: Final = 8
KERNEL: Final = np.array([0.25, 0.5, 0.25])
SITES: Final = ((2, ((0, 0),)), (1, ((0, 1), (1, 0))), (0, ((1, 1),)))
"""Channels of a picture (B, G, R) and the pixels of every 2x2 that show them in the mosaic, RGGB."""


def decoded(data: bytes, stream: StreamFormat) -> NDArray[np.uint8] | None:
    """Return the picture, uint8 array of shape (H, W, 3), B, G, R; None when it is damaged."""
    buffer = np.frombuffer(data, np.uint8)
    rows, columns = stream.rows, stream.columns
    if stream.pixel_format in ("MJPG", "JPEG"):
        try:
            picture = cv2.imdecode(buffer, cv2.IMREAD_COLOR)
        except cv2.error:
            return None
        if picture is None or picture.shape[:2] != (rows, columns):
            return None
        return np.asarray(picture, np.uint8)
    row_bytes = stream.row_bytes or columns * (2 if stream.pixel_format == "YUYV" else 3)
    if buffer.size < rows * row_bytes:
        return None
    lines = buffer[: rows * row_bytes].reshape(rows, row_bytes)
    if stream.pixel_format == "YUYV":
        packed = np.ascontiguousarray(lines[:, : 2 * columns]).reshape(rows, columns, 2)
        return np.asarray(cv2.cvtColor(packed, cv2.COLOR_YUV2BGR_YUYV), np.uint8)
    return np.ascontiguousarray(lines[:, : 3 * columns].reshape(rows, columns, 3)[..., ::-1])


def mosaic_of(picture: NDArray[np.uint8], encoding: Literal["srgb", "linear"]) -> NDArray[np.uint16]:
    """Return the mosaic of a picture, uint16 array of shape (H, W), RGGB, linear light of 0 to `WHITE_DN`.

    picture : uint8 array of shape (H, W, 3), B, G, R; H and W are even
    """
    light = _light(encoding)
    mosaic = np.empty(picture.shape[:2], np.uint16)
    for channel, sites in SITES:
        mean = _means(light[picture[..., channel]], picture[..., channel] >= CLIPPED_FROM)
        for row, column in sites:
            mosaic[row::2, column::2] = mean[row::2, column::2]
    return mosaic


def aiming_picture(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a small grey picture, uint8 array of shape (H / 8, W / 8)."""
    rows, columns, _ = picture.shape
    small = cv2.resize(picture, (columns // AIMING_STEP, rows // AIMING_STEP), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.uint8)


def _means(light: NDArray[np.uint16], saturated: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Return the mean light around each pixel, uint16 array (H, W); white where one of the pixels is saturated."""
    mean = np.asarray(cv2.sepFilter2D(light, -1, KERNEL, KERNEL, borderType=cv2.BORDER_REFLECT_101), np.uint16)
    if saturated.any():
        mean[cv2.dilate(saturated.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0] = WHITE_DN
    return mean


@lru_cache(maxsize=2)
def _light(encoding: Literal["srgb", "linear"]) -> NDArray[np.uint16]:
    """Return linear light of each stored value, uint16 array of 256 entries."""
    values = np.arange(256) / 255.0
    if encoding == "srgb":  # IEC 61966-2-1
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return np.rint(values * WHITE_DN).astype(np.uint16)


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
        """Return the next frame that ends after now.

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
        """Return the next small grey picture, uint8 array of shape (H / 8, W / 8). Errors as for `next_frame`."""
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
        """Return the next frame's part of the picture (B, G, R), when its exposure began (ns), and its settings."""
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
        """Return the result of `act`; a camera that the kernel lost is closed, so that the next call opens it again."""
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


# Choice of the camera on USB that is the sensor: found once by a part of its name, and from then on by all of it.


class ChosenCamera:
    """One camera of a machine, the same one after it was unplugged and plugged in again.

    Parameters
    ----------
    stack : the machine's cameras, or emulated ones
    card : part of the name or serial number of exactly one of them
    """

    def __init__(self, stack: VideoStack, card: str) -> None:
        self._stack = stack
        self._card = card
        self._name: str | None = None

    @property
    def name(self) -> str:
        """Full name with the serial number; before it is first found, the part of it in the profile."""
        return self._name or self._card

    def open(self) -> VideoDevice:
        """Find and open it, under whatever device file it has now.

        Raises
        ------
        CameraError
            It is absent, or more than one has its name.
        OSError
            The kernel refuses it.
        """
        found = self._find()
        self._name = found.name
        return self._stack.open(found.path)

    def _find(self) -> VideoInfo:
        present = self._stack.cameras()
        known = self._name
        found = [info for info in present if (info.name == known if known else self._card in info.name)]
        if len(found) == 1:
            return found[0]
        names = ", ".join(f"{info.name} ({info.path})" for info in present) or "none"
        problem = "is not there" if not found else "is ambiguous"
        raise CameraError(
            f"camera {self.name} {problem}: cameras are {names}; plug it in, check that the user is in the group "
            "video, and uvc.card in the board profile"
        )
