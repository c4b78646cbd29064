"""The part of the kernel's video interface that is used, as Protocols: real in `v4l2_kernel`, emulated for tests."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

CONTROLS: Final = {
    "brightness": 0x00980900,
    "contrast": 0x00980901,
    "saturation": 0x00980902,
    "hue": 0x00980903,
    "white_balance_automatic": 0x0098090C,
    "red_balance": 0x0098090E,
    "blue_balance": 0x0098090F,
    "gamma": 0x00980910,
    "automatic_gain": 0x00980912,
    "gain": 0x00980913,
    "power_line_frequency": 0x00980918,
    "white_balance_temperature": 0x0098091A,
    "sharpness": 0x0098091B,
    "backlight_compensation": 0x0098091C,
    "automatic_exposure": 0x009A0901,
    "exposure_time": 0x009A0902,
    "exposure_dynamic_framerate": 0x009A0903,
    "focus": 0x009A090A,
    "focus_automatic": 0x009A090C,
    "zoom": 0x009A090D,
}
"""The kernel's numbers of the controls (`V4L2_CID_…`); exposure is in steps of 100 µs."""


@dataclass(frozen=True, slots=True)
class VideoInfo:
    """A camera: its device file, the name that the kernel gives it, and its serial number where it states one."""

    path: str
    card: str
    serial: str = ""

    @property
    def name(self) -> str:
        """The kernel's name and the serial number, unless the name holds it."""
        return self.card if self.serial in self.card else f"{self.card} {self.serial}"


@dataclass(frozen=True, slots=True)
class ControlRange:
    """Values that a control accepts."""

    lowest: int
    highest: int
    step: int


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """A picture's size, pixel format as four letters, and bytes of a row (0 when it is compressed)."""

    columns: int
    rows: int
    pixel_format: str
    row_bytes: int


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A picture as the camera sent it.

    stamped_ns : monotonic time at which its first data arrived
    """

    data: bytes
    stamped_ns: int


class VideoDevice(Protocol):
    """An open camera; every call raises `OSError` when the kernel refuses it or the camera is gone."""

    def granted_format(self, asked: StreamFormat, frame_period_us: float) -> StreamFormat:
        """Request a format and return the one that is granted."""
        ...

    def control_range(self, control: int) -> ControlRange | None:
        """Return what a control accepts; None when the camera does not have it."""
        ...

    def read_control(self, control: int) -> int:
        """Return the value of a control, from the camera."""
        ...

    def write_control(self, control: int, value: int) -> None:
        """Set a control."""
        ...

    def start(self) -> None:
        """Start streaming."""
        ...

    def next_picture(self, timeout_s: float) -> Picture | None:
        """Return the oldest picture that waits, or the next; None after `timeout_s`. Damaged ones are left out."""
        ...

    def close(self) -> None:
        """Stop and release the camera."""
        ...


class VideoStack(Protocol):
    """The cameras of a machine."""

    def cameras(self) -> list[VideoInfo]:
        """Return every camera that can stream pictures."""
        ...

    def open(self, path: str) -> VideoDevice:
        """Open the camera of this device file."""
        ...
