"""Structures and calls of the kernel's video interface (`linux/videodev2.h`) for 64-bit machines."""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_long, c_uint8, c_uint32, c_ulong, c_void_p
from typing import Final

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
    """Number of an `ioctl` of the video interface."""
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
    """A pixel format's four letters."""
    return code.to_bytes(4, "little").decode("latin-1")


def format_code(letters: str) -> int:
    """The number of a pixel format."""
    return int.from_bytes(letters.encode("latin-1"), "little")
