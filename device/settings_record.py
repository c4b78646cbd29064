"""Camera settings as records hold them."""

from __future__ import annotations

from device.records import Positive, Record
from hal.frame import CameraSettings


class SettingsRecord(Record, frozen=True):
    """Exposure (µs) and analogue gain of the camera."""

    exposure_us: Positive
    analogue_gain: Positive

    @classmethod
    def of(cls, settings: CameraSettings) -> SettingsRecord:
        """The same as a record."""
        return cls(exposure_us=settings.exposure_us, analogue_gain=settings.analogue_gain)

    @property
    def settings(self) -> CameraSettings:
        """The same as the request that a camera takes."""
        return CameraSettings(self.exposure_us, self.analogue_gain)
