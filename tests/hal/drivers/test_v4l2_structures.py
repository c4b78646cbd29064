"""Structures, calls and control numbers against the kernel's own header; skipped without a compiler or the header."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

from hal.drivers import v4l2_kernel as ours
from hal.drivers.v4l2_stack import CONTROLS

HEADER = Path("/usr/include/linux/videodev2.h")
NAMES = {
    "automatic_exposure": "EXPOSURE_AUTO",
    "exposure_time": "EXPOSURE_ABSOLUTE",
    "exposure_dynamic_framerate": "EXPOSURE_AUTO_PRIORITY",
    "white_balance_automatic": "AUTO_WHITE_BALANCE",
    "automatic_gain": "AUTOGAIN",
    "focus": "FOCUS_ABSOLUTE",
    "focus_automatic": "FOCUS_AUTO",
    "zoom": "ZOOM_ABSOLUTE",
}
SIZES = {
    "v4l2_capability": ours.Capability,
    "v4l2_pix_format": ours.PixelFormat,
    "v4l2_format": ours.Format,
    "v4l2_captureparm": ours.CaptureParameters,
    "v4l2_streamparm": ours.StreamParameters,
    "v4l2_queryctrl": ours.ControlQuery,
    "v4l2_control": ours.ControlValue,
    "v4l2_requestbuffers": ours.BufferRequest,
    "v4l2_buffer": ours.Buffer,
}
PLACES = {
    ("v4l2_capability", "device_caps"): ours.Capability.device_caps.offset,
    ("v4l2_format", "fmt"): ours.Format.fmt.offset,
    ("v4l2_queryctrl", "minimum"): ours.ControlQuery.minimum.offset,
    ("v4l2_queryctrl", "flags"): ours.ControlQuery.flags.offset,
    ("v4l2_captureparm", "timeperframe"): ours.CaptureParameters.numerator.offset,
    ("v4l2_buffer", "timestamp"): ours.Buffer.seconds.offset,
    ("v4l2_buffer", "sequence"): ours.Buffer.sequence.offset,
    ("v4l2_buffer", "m"): ours.Buffer.m.offset,
    ("v4l2_buffer", "length"): ours.Buffer.length.offset,
}
CONSTANTS = {
    "V4L2_BUF_TYPE_VIDEO_CAPTURE": ours.CAPTURE,
    "V4L2_MEMORY_MMAP": ours.MAPPED,
    "V4L2_CAP_VIDEO_CAPTURE": ours.CAPABLE_CAPTURE,
    "V4L2_CAP_STREAMING": ours.CAPABLE_STREAMING,
    "V4L2_CAP_DEVICE_CAPS": ours.CAPABLE_PER_NODE,
    "V4L2_CTRL_FLAG_DISABLED": ours.CONTROL_DISABLED,
    "V4L2_BUF_FLAG_ERROR": ours.BUFFER_ERROR,
    "V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC": ours.MONOTONIC,
    "V4L2_BUF_FLAG_TIMESTAMP_MASK": ours.CLOCK_MASK,
    "V4L2_PIX_FMT_MJPEG": ours.format_code("MJPG"),
    "V4L2_PIX_FMT_YUYV": ours.format_code("YUYV"),
    "V4L2_PIX_FMT_RGB24": ours.format_code("RGB3"),
    "V4L2_EXPOSURE_MANUAL": 1,
}


@pytest.mark.skipif(not HEADER.exists() or shutil.which("gcc") is None, reason="needs gcc and linux/videodev2.h")
def test_they_are_those_of_the_kernels_header(tmp_path: Path) -> None:
    wanted = {f"sizeof(struct {name})": ctypes.sizeof(kind) for name, kind in SIZES.items()}
    wanted |= {f"offsetof(struct {kind}, {name})": offset for (kind, name), offset in PLACES.items()}
    wanted |= CONSTANTS | ours.CALLS
    wanted |= {f"V4L2_CID_{NAMES.get(name, name.upper())}": number for name, number in CONTROLS.items()}
    prints = "".join(f'printf("%lu\\n", (unsigned long)({expression}));' for expression in wanted)
    source = tmp_path / "header.c"
    source.write_text(
        f"#include <stddef.h>\n#include <stdio.h>\n#include <linux/videodev2.h>\nint main(void) {{ {prints} }}"
    )
    program = tmp_path / "header"
    subprocess.run(["gcc", "-o", program, source], check=True, timeout=60)
    printed = subprocess.run([program], check=True, capture_output=True, text=True, timeout=10).stdout.split()
    assert dict(zip(wanted, map(int, printed), strict=True)) == wanted


def test_four_letters_and_back() -> None:
    assert ours.four_letters(ours.format_code("YUYV")) == "YUYV"
