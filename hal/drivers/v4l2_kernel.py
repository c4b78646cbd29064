"""Cameras of this machine through the kernel's video interface, without a library in between."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import select
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

from hal.drivers.v4l2_stack import ControlRange, Picture, StreamFormat, VideoDevice, VideoInfo
from hal.drivers.v4l2_structures import (
    BUFFER_ERROR,
    CALLS,
    CAPABLE_CAPTURE,
    CAPABLE_PER_NODE,
    CAPABLE_STREAMING,
    CAPTURE,
    CLOCK_MASK,
    CONTROL_DISABLED,
    MAPPED,
    MONOTONIC,
    Buffer,
    BufferRequest,
    Capability,
    ControlQuery,
    ControlValue,
    Format,
    StreamParameters,
    format_code,
    four_letters,
)

BUFFERS: Final = 4
DEVICES: Final = Path("/dev")
CLASSES: Final = Path("/sys/class/video4linux")
US_PER_S: Final = 1_000_000


class KernelVideo:
    """See `VideoStack`."""

    def cameras(self) -> list[VideoInfo]:
        """Every device file that is a camera and can be opened."""
        found = []
        for path in sorted(DEVICES.glob("video*")):
            with suppress(OSError):
                handle = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
                try:
                    info = _capability(handle)
                finally:
                    os.close(handle)
                able = info.device_caps if info.capabilities & CAPABLE_PER_NODE else info.capabilities
                if able & CAPABLE_CAPTURE and able & CAPABLE_STREAMING:
                    found.append(VideoInfo(str(path), info.card.decode(errors="replace"), _serial(path)))
        return found

    def open(self, path: str) -> VideoDevice:
        """Open the camera of this device file."""
        return KernelCamera(path)


class KernelCamera:
    """See `VideoDevice`."""

    def __init__(self, path: str) -> None:
        self._handle = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._memory: list[mmap.mmap] = []
        self._poll = select.poll()
        self._poll.register(self._handle, select.POLLIN)

    def granted_format(self, asked: StreamFormat, frame_period_us: float) -> StreamFormat:
        """Request a format and a frame period, and return the format that is granted."""
        told = Format(type=CAPTURE)
        told.fmt.pix.width, told.fmt.pix.height = asked.columns, asked.rows
        told.fmt.pix.pixelformat = format_code(asked.pixel_format)
        told.fmt.pix.field = 1  # none: the whole picture at once
        self._do("VIDIOC_S_FMT", told)
        rate = StreamParameters(type=CAPTURE)
        rate.parm.capture.numerator = round(frame_period_us)
        rate.parm.capture.denominator = US_PER_S
        self._do("VIDIOC_S_PARM", rate)
        pix = told.fmt.pix
        return StreamFormat(pix.width, pix.height, four_letters(pix.pixelformat), pix.bytesperline)

    def control_range(self, control: int) -> ControlRange | None:
        """Return what a control accepts; None when the camera does not have it."""
        query = ControlQuery(id=control)
        try:
            self._do("VIDIOC_QUERYCTRL", query)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return None
            raise
        if query.flags & CONTROL_DISABLED:
            return None
        return ControlRange(query.minimum, query.maximum, query.step)

    def read_control(self, control: int) -> int:
        """Value of a control, from the camera."""
        value = ControlValue(id=control)
        self._do("VIDIOC_G_CTRL", value)
        return int(value.value)

    def write_control(self, control: int, value: int) -> None:
        """Set a control."""
        self._do("VIDIOC_S_CTRL", ControlValue(id=control, value=value))

    def start(self) -> None:
        """Map the buffers, hand them to the camera and start streaming."""
        request = BufferRequest(count=BUFFERS, type=CAPTURE, memory=MAPPED)
        self._do("VIDIOC_REQBUFS", request)
        for index in range(request.count):
            buffer = Buffer(index=index, type=CAPTURE, memory=MAPPED)
            self._do("VIDIOC_QUERYBUF", buffer)
            self._memory.append(mmap.mmap(self._handle, buffer.length, offset=buffer.m.offset))
            self._do("VIDIOC_QBUF", buffer)
        self._do("VIDIOC_STREAMON", ctypes.c_int32(CAPTURE))

    def next_picture(self, timeout_s: float) -> Picture | None:
        """The oldest picture that waits, or the next; None after `timeout_s`, or of a damaged one."""
        events = self._poll.poll(max(timeout_s, 0.0) * 1e3)
        if not events:
            return None
        if events[0][1] & (select.POLLERR | select.POLLHUP | select.POLLNVAL):
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        buffer = Buffer(type=CAPTURE, memory=MAPPED)
        try:
            self._do("VIDIOC_DQBUF", buffer)
        except BlockingIOError:
            return None
        data = self._memory[buffer.index][: buffer.bytesused]
        stamped_ns = buffer.seconds * 1_000_000_000 + buffer.microseconds * 1_000
        is_monotonic = buffer.flags & CLOCK_MASK == MONOTONIC
        is_damaged = bool(buffer.flags & BUFFER_ERROR)
        self._do("VIDIOC_QBUF", buffer)
        if not is_monotonic:
            raise OSError(errno.EPROTO, "its pictures are not stamped by the monotonic clock")
        return None if is_damaged else Picture(data, stamped_ns)

    def close(self) -> None:
        """Stop and release the camera."""
        with suppress(OSError):  # a camera that was unplugged is already gone
            self._do("VIDIOC_STREAMOFF", ctypes.c_int32(CAPTURE))
        for memory in self._memory:
            memory.close()
        self._memory.clear()
        handle, self._handle = self._handle, -1
        if handle >= 0:
            os.close(handle)

    def _do(self, name: str, argument: ctypes._CData) -> None:
        _ioctl(self._handle, name, argument)


def _serial(path: Path) -> str:
    """Serial number of the USB device behind a device file; empty where there is none."""
    try:
        return ((CLASSES / path.name / "device").resolve().parent / "serial").read_text(errors="replace").strip()
    except OSError:
        return ""


def _capability(handle: int) -> Capability:
    info = Capability()
    _ioctl(handle, "VIDIOC_QUERYCAP", info)
    return info


def _ioctl(handle: int, name: str, argument: ctypes._CData) -> None:
    """A call into the kernel, which writes its answer into `argument`."""
    if sys.platform == "linux":
        import fcntl

        fcntl.ioctl(handle, CALLS[name], argument)
