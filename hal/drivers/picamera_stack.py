"""The part of picamera2 that is used, as Protocols, and the only place that imports it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hal.drivers.i2c_bus import require_package
from hal.errors import DriverMissing


class Request(Protocol):
    """A completed request: its buffers return to the camera once it is released."""

    def get_metadata(self) -> dict[str, Any]:
        """Return the frame's own metadata."""
        ...

    def make_array(self, name: str) -> NDArray[np.uint8]:
        """Return a copy of a stream's buffer, uint8 array of shape (rows, stride) for raw."""
        ...

    def release(self) -> None:
        """Return the buffers."""
        ...


class Job(Protocol):
    """A pending request."""

    def get_result(self, timeout: float | None = None) -> Request:
        """Return the request; TimeoutError when it does not come in time, CancelledError when it was cancelled."""
        ...


class OpenCamera(Protocol):
    """The part of an opened `Picamera2` that is used."""

    def create_still_configuration(self, **configuration: Any) -> dict[str, Any]:
        """Create a configuration."""
        ...

    def configure(self, configuration: dict[str, Any]) -> None:
        """Configure the streams."""
        ...

    def camera_configuration(self) -> dict[str, Any]:
        """Granted configuration, by stream."""
        ...

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        """Request controls; they act some frames later."""
        ...

    def start(self) -> None:
        """Start streaming."""
        ...

    def capture_request(self, wait: bool) -> Job:
        """Return the next completed request, or a job for it without `wait`."""
        ...

    def cancel_all_and_flush(self) -> None:
        """Cancel every job."""
        ...

    def close(self) -> None:
        """Stop and release the camera."""
        ...


class CameraStack(Protocol):
    """The part of the class `Picamera2` that is used."""

    def global_camera_info(self) -> list[dict[str, Any]]:
        """Return every attached camera: "Id", "Model", "Num"."""
        ...

    def __call__(self, camera_num: int) -> OpenCamera:
        """Open the camera at that index of the list."""
        ...


def load_picamera2() -> CameraStack:
    """Return the class `Picamera2`.

    Raises
    ------
    DriverMissing
        picamera2 or libcamera is not installed, or does not match the packages around it.
    """
    for library in ("picamera2", "libcamera"):
        require_package(
            library,
            "apt install python3-picamera2 --no-install-recommends, in a venv made with --system-site-packages",
        )
    try:
        from picamera2 import Picamera2
    except (ImportError, ValueError, AttributeError, RuntimeError, OSError) as error:
        raise DriverMissing(
            f"picamera2 is installed but cannot be imported ({error}): if it names numpy, `pip install simplejpeg` "
            "in the venv or use numpy from apt; else `apt install --reinstall python3-picamera2 python3-libcamera`"
        ) from error

    # Its errors are raised too and reported in one sentence; without this, Python also prints them.
    logging.getLogger("picamera2").addHandler(logging.NullHandler())
    stack: CameraStack = Picamera2
    return stack
