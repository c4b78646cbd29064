"""What is used of picamera2, as a Protocol, and the one place that imports it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hal.driver_library import require
from hal.errors import DriverMissing


class Request(Protocol):
    """A completed request: its buffers belong to the camera again once it is released."""

    def get_metadata(self) -> dict[str, Any]:
        """The frame's own metadata."""
        ...

    def make_array(self, name: str) -> NDArray[np.uint8]:
        """A copy of a stream's buffer, uint8 array of shape (rows, stride) for raw."""
        ...

    def release(self) -> None:
        """Give the buffers back."""
        ...


class Job(Protocol):
    """A request that is to come."""

    def get_result(self, timeout: float | None = None) -> Request:
        """The request; TimeoutError when it does not come in time, CancelledError when it was called off."""
        ...


class OpenCamera(Protocol):
    """What is used of an opened `Picamera2`."""

    def create_still_configuration(self, **configuration: Any) -> dict[str, Any]:
        """A configuration."""
        ...

    def configure(self, configuration: dict[str, Any]) -> None:
        """Configure the streams."""
        ...

    def camera_configuration(self) -> dict[str, Any]:
        """What was granted, by stream."""
        ...

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        """Ask for controls; frames show them some frames later."""
        ...

    def start(self) -> None:
        """Begin to stream."""
        ...

    def capture_request(self, wait: bool) -> Job:
        """The next completed request, as a job when not waited for."""
        ...

    def cancel_all_and_flush(self) -> None:
        """Call off every job."""
        ...

    def close(self) -> None:
        """Stop and release the camera."""
        ...


class CameraStack(Protocol):
    """What is used of the class `Picamera2` itself."""

    def global_camera_info(self) -> list[dict[str, Any]]:
        """Every attached camera: "Id", "Model", "Num"."""
        ...

    def __call__(self, camera_num: int) -> OpenCamera:
        """Open the camera at that place of the list."""
        ...


def load_picamera2() -> CameraStack:
    """The class `Picamera2`.

    Raises
    ------
    DriverMissing
        picamera2 or libcamera is not installed, or does not fit the libraries around it.
    """
    for library in ("picamera2", "libcamera"):
        require(
            library,
            "apt install python3-picamera2 --no-install-recommends, in a venv made with --system-site-packages",
        )
    try:
        from picamera2 import Picamera2
    except (ImportError, ValueError, AttributeError, RuntimeError, OSError) as error:
        raise DriverMissing(
            f"picamera2 is installed and cannot be imported ({error}): where numpy is named, `pip install simplejpeg` "
            "in the venv or stay on apt's numpy; else `apt install --reinstall python3-picamera2 python3-libcamera`"
        ) from error

    # What it complains of is raised too, and told in a sentence: without this, Python writes it to the screen as well.
    logging.getLogger("picamera2").addHandler(logging.NullHandler())
    stack: CameraStack = Picamera2
    return stack
