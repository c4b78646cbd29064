"""Stands where picamera2 imports kms++ for its preview on a screen: Debian has none, and nothing here shows one."""

from enum import Enum


class PixelFormat(Enum):
    """The names that picamera2 puts into its table of formats."""

    RGB888 = 1
    BGR888 = 2
    XRGB8888 = 3
    XBGR8888 = 4
    YUV420 = 5
    YVU420 = 6
    YUYV = 7
    MJPEG = 8
    NV12 = 9
    ABGR8888 = 10
    YVYU = 11
