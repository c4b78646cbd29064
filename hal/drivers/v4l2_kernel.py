"""Cameras of this machine through the kernel's video interface, without a library in between."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import select
import sys
from contextlib import suppress
from ctypes import c_char, c_int32, c_long, c_uint8, c_uint32, c_ulong, c_void_p
from pathlib import Path
from typing import Final

from hal.drivers.v4l2_stack import ControlRange, Picture, StreamFormat, VideoDevice, VideoInfo

BUFFERS: Final = 4
DEVICES: Final = Path("/dev")
CLASSES: Final = Path("/sys/class/video4linux")
US_PER_S: Final = 1_000_000


class KernelVideo:
    """See `VideoStack`."""

    def cameras(self) -> list[VideoInfo]:
        """Return every device file that is a camera and can be opened."""
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
        requested = Format(type=CAPTURE)
        requested.fmt.pix.width, requested.fmt.pix.height = asked.columns, asked.rows
        requested.fmt.pix.pixelformat = format_code(asked.pixel_format)
        requested.fmt.pix.field = 1  # none: the whole picture at once
        self._do("VIDIOC_S_FMT", requested)
        rate = StreamParameters(type=CAPTURE)
        rate.parm.capture.numerator = round(frame_period_us)
        rate.parm.capture.denominator = US_PER_S
        self._do("VIDIOC_S_PARM", rate)
        pix = requested.fmt.pix
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
        """Return the value of a control, from the camera."""
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
        """Return the oldest picture that waits, or the next; None after `timeout_s`, or of a damaged one."""
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
    """Return the serial number of the USB device behind a device file; empty where there is none."""
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


# Structures and calls of the kernel's video interface (`linux/videodev2.h`) for 64-bit machines.

CAPTURE: Final = 1
"""Type of buffers that a camera fills (`V4L2_BUF_TYPE_VIDEO_CAPTURE`)."""

MAPPED: Final = 1
"""Buffers that the kernel maps (`V4L2_MEMORY_MMAP`)."""

CAPABLE_CAPTURE: Final = 0x00000001
CAPABLE_STREAMING: Final = 0x04000000
CAPABLE_PER_NODE: Final = 0x80000000
CONTROL_DISABLED: Final = 0x0001
BUFFER_ERROR: Final = 0x0040
MONOTONIC: Final = 0x2000
CLOCK_MASK: Final = 0xE000


class Capability(ctypes.Structure):
    """`struct v4l2_capability`."""

    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class PixelFormat(ctypes.Structure):
    """`struct v4l2_pix_format`."""

    _fields_ = tuple(
        (name, c_uint32)
        for name in (
            "width",
            "height",
            "pixelformat",
            "field",
            "bytesperline",
            "sizeimage",
            "colorspace",
            "priv",
            "flags",
            "ycbcr_enc",
            "quantization",
            "xfer_func",
        )
    )


class _FormatUnion(ctypes.Union):
    _fields_ = (("pix", PixelFormat), ("raw", c_uint8 * 200), ("aligned", c_void_p))


class Format(ctypes.Structure):
    """`struct v4l2_format`."""

    _fields_ = (("type", c_uint32), ("fmt", _FormatUnion))


class CaptureParameters(ctypes.Structure):
    """`struct v4l2_captureparm`; the frame period is numerator / denominator seconds."""

    _fields_ = (
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("numerator", c_uint32),
        ("denominator", c_uint32),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("reserved", c_uint32 * 4),
    )


class _ParametersUnion(ctypes.Union):
    _fields_ = (("capture", CaptureParameters), ("raw", c_uint8 * 200))


class StreamParameters(ctypes.Structure):
    """`struct v4l2_streamparm`."""

    _fields_ = (("type", c_uint32), ("parm", _ParametersUnion))


class ControlQuery(ctypes.Structure):
    """`struct v4l2_queryctrl`."""

    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_uint8 * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("default_value", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


class ControlValue(ctypes.Structure):
    """`struct v4l2_control`."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


class BufferRequest(ctypes.Structure):
    """`struct v4l2_requestbuffers`."""

    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    )


class _BufferPlace(ctypes.Union):
    _fields_ = (("offset", c_uint32), ("userptr", c_ulong), ("planes", c_void_p), ("fd", c_int32))


class Buffer(ctypes.Structure):
    """`struct v4l2_buffer`."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("seconds", c_long),
        ("microseconds", c_long),
        ("timecode", c_uint32 * 4),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("m", _BufferPlace),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    )


_READ, _WRITE = 2, 1


def _call(direction: int, number: int, size: int) -> int:
    """Return the number of an `ioctl` of the video interface."""
    return direction << 30 | size << 16 | ord("V") << 8 | number


CALLS: Final = {
    "VIDIOC_QUERYCAP": _call(_READ, 0, ctypes.sizeof(Capability)),
    "VIDIOC_S_FMT": _call(_READ | _WRITE, 5, ctypes.sizeof(Format)),
    "VIDIOC_REQBUFS": _call(_READ | _WRITE, 8, ctypes.sizeof(BufferRequest)),
    "VIDIOC_QUERYBUF": _call(_READ | _WRITE, 9, ctypes.sizeof(Buffer)),
    "VIDIOC_QBUF": _call(_READ | _WRITE, 15, ctypes.sizeof(Buffer)),
    "VIDIOC_DQBUF": _call(_READ | _WRITE, 17, ctypes.sizeof(Buffer)),
    "VIDIOC_STREAMON": _call(_WRITE, 18, ctypes.sizeof(c_int32)),
    "VIDIOC_STREAMOFF": _call(_WRITE, 19, ctypes.sizeof(c_int32)),
    "VIDIOC_S_PARM": _call(_READ | _WRITE, 22, ctypes.sizeof(StreamParameters)),
    "VIDIOC_G_CTRL": _call(_READ | _WRITE, 27, ctypes.sizeof(ControlValue)),
    "VIDIOC_S_CTRL": _call(_READ | _WRITE, 28, ctypes.sizeof(ControlValue)),
    "VIDIOC_QUERYCTRL": _call(_READ | _WRITE, 36, ctypes.sizeof(ControlQuery)),
}


def four_letters(code: int) -> str:
    """Return a pixel format's four letters."""
    return code.to_bytes(4, "little").decode("latin-1")


def format_code(letters: str) -> int:
    """Return the number of a pixel format."""
    return int.from_bytes(letters.encode("latin-1"), "little")
