"""Locks what a camera on USB would change by itself, and proves it by reading back.

Such a camera has no metadata for a frame: that exposure, gain, white balance and focus were as requested follows from
the controls' values before and after it.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from typing import Final

from hal.drivers.v4l2_stack import CONTROLS, ControlRange, VideoDevice
from hal.errors import CameraError
from hal.frame import CameraSettings
from hal.profile_tables import UvcConfig, UvcProperty

EXPOSURE_UNIT_US: Final = 100.0
MANUAL: Final = 1
"""Value of automatic_exposure at which the camera changes neither exposure nor iris."""

AUTOMATIC_OFF: Final = {
    "automatic_exposure": MANUAL,
    "exposure_dynamic_framerate": 0,
    "automatic_gain": 0,
    "white_balance_automatic": 0,
    "focus_automatic": 0,
    "backlight_compensation": 0,
}
"""Automatic changes and the value that stops each; set wherever the camera has the control."""

PROVED_BY: Final[dict[UvcProperty, tuple[str, ...]]] = {
    "exposure": ("automatic_exposure", "exposure_time"),
    "gain": ("gain",),
    "white balance": ("white_balance_automatic",),
    "focus": ("focus_automatic",),
}
"""Controls that a property needs so that it can be locked."""


class LockedControls:
    """The controls of one open camera.

    Parameters
    ----------
    stated : exposure and gain of the profile, which an exposure without a control is fixed at
    kept : values of controls for which the profile has none, as first read; later openings hold the same ones

    Raises
    ------
    CameraError
        A property can be neither locked nor is said to be fixed; names it.
    """

    def __init__(
        self, device: VideoDevice, camera_id: str, stated: CameraSettings, config: UvcConfig, kept: dict[str, int]
    ) -> None:
        self._device = device
        self._camera_id = camera_id
        self._stated = stated
        self._config = config
        self._kept = kept
        self._ranges = {name: device.control_range(number) for name, number in CONTROLS.items()}
        self._wanted: dict[str, int] = {}
        for name in self._unproved():
            raise CameraError(
                f"camera {camera_id} cannot lock its {name[0]}: it has no control {name[1]!r}; if its maker says that "
                f"it never changes, add {name[0]!r} to uvc.fixed in the board profile"
            )
        unknown = [name for name in config.controls if name not in CONTROLS]
        if unknown:
            raise CameraError(f"uvc.controls: {unknown[0]!r} is not a control; accepted: {', '.join(CONTROLS)}")

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Set every control, read it back, and return exposure and gain as granted.

        An exposure that the camera cannot set is the profile's.

        Raises
        ------
        CameraError
            A control keeps another value; names it.
        """
        self._wanted = dict(self._values(settings))
        for name, value in self._wanted.items():
            self._write(name, value)
        self.prove()
        exposed, gain = self._wanted.get("exposure_time"), self._wanted.get("gain")
        return CameraSettings(
            self._stated.exposure_us if exposed is None else exposed * EXPOSURE_UNIT_US,
            1.0 if gain is None or not self._config.gain_units else gain / self._config.gain_units,
        )

    def prove(self) -> None:
        """Read every locked control.

        Raises
        ------
        CameraError
            One differs from what was set; names it.
        """
        for name, value in self._wanted.items():
            found = self._device.read_control(CONTROLS[name])
            if found != value:
                raise CameraError(
                    f"camera {self._camera_id} does not keep its control {name}: {value} was set and {found} is read; "
                    "end other programs that use it, or correct the board profile"
                )

    def _unproved(self) -> Iterator[tuple[UvcProperty, str]]:
        for what, names in PROVED_BY.items():
            missing = [name for name in names if self._ranges[name] is None]
            if missing and what not in self._config.fixed:
                yield what, missing[0]

    def _values(self, settings: CameraSettings) -> Iterator[tuple[str, int]]:
        """Yield controls and their values, automatic ones first: they hold back those that they would change."""
        config = self._config
        asked: dict[str, float | None] = {
            "exposure_time": settings.exposure_us // EXPOSURE_UNIT_US,
            "gain": None if config.gain_units is None else settings.analogue_gain * config.gain_units,
            "white_balance_temperature": config.white_balance_k,
            "focus": config.focus_units,
        }
        for name, off in AUTOMATIC_OFF.items():
            if self._ranges[name] is not None:
                yield name, config.controls.get(name, off)
        for name, value in asked.items():
            limits = self._ranges[name]
            if limits is None or name in config.controls:
                continue
            if value is None:
                if name not in self._kept:
                    self._kept[name] = self._device.read_control(CONTROLS[name])
                yield name, self._kept[name]
            else:
                yield name, _granted(value, limits)
        for name, fixed in config.controls.items():
            if name not in AUTOMATIC_OFF:
                if self._ranges[name] is None:
                    raise CameraError(
                        f"camera {self._camera_id} has no control {name}: take it out of uvc.controls in the board "
                        "profile"
                    )
                yield name, fixed

    def _write(self, name: str, value: int) -> None:
        try:
            self._device.write_control(CONTROLS[name], value)
        except OSError as error:
            if error.errno == errno.ENODEV:
                raise
            if self._device.read_control(CONTROLS[name]) == value:
                return  # read-only, and as wanted
            raise CameraError(
                f"camera {self._camera_id} refuses {value} for its control {name} "
                f"({os.strerror(error.errno) if error.errno else error}): correct the board profile"
            ) from error


def _granted(value: float, limits: ControlRange) -> int:
    """Return the nearest value that a control accepts."""
    step = max(limits.step, 1)
    inside = min(max(round(value), limits.lowest), limits.highest)
    return limits.lowest + (inside - limits.lowest) // step * step
