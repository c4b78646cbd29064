"""What can be made to go wrong in the camera stack of the twin's wired board."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass


@dataclass(slots=True)
class StackFaults:
    """Switches of the camera stack, thrown at any time; the sensor's own are the bench's.

    no_memory : the kernel has no contiguous memory when the camera is configured
    in_use : another program holds the camera
    raw_format : the format that is granted whatever is asked for
    no_raw : the camera has no raw modes, as libcamera's virtual one: picamera2 stumbles over that as it opens it
    no_raw_granted : no raw stream is granted
    rows_lost : rows that are missing at the end of every raw buffer
    stalled_openings : times that the opened camera delivers nothing until it is opened again
    unmappable : buffers cannot be mapped
    without : a key that is missing from the metadata
    clock_offset_ns : the frames are stamped by another clock, this much ahead
    unlisted : libcamera cannot list the cameras
    timed_out : a call that the kernel gives up with "connection timed out", such as "configure"
    late_requests : requests that complete just while they are called off, and are handed over after that
    """

    no_memory: bool = False
    in_use: bool = False
    raw_format: str = ""
    no_raw: bool = False
    no_raw_granted: bool = False
    rows_lost: int = 0
    stalled_openings: int = 0
    unmappable: bool = False
    without: str = ""
    clock_offset_ns: int = 0
    unlisted: bool = False
    timed_out: str = ""
    late_requests: int = 0

    def check(self, call: str) -> None:
        """Fail as the kernel does when its time is up."""
        if self.timed_out == call:
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
