"""The light fingerprint: what a calibration and every frame that it is used on must agree in."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal

from device.bundles.record import Coordinate, Positive, Record, ShortText
from hal.board_profile import BoardProfile
from hal.frame import CameraSettings, StatedOrder

SETTING_TOLERANCE: Final = 0.02
"""Relative: granted exposure, gain and current differ slightly from the requested ones."""

POSITION_TOLERANCE_MM: Final = 0.05

Orientation = Literal["rows-down"]


class SettingsRecord(Record, frozen=True):
    """Exposure (µs) and analogue gain of the camera."""

    exposure_us: Positive
    analogue_gain: Positive

    @classmethod
    def of(cls, settings: CameraSettings) -> SettingsRecord:
        """Return the settings as a record."""
        return cls(exposure_us=settings.exposure_us, analogue_gain=settings.analogue_gain)

    @property
    def settings(self) -> CameraSettings:
        """The settings as a request to a camera."""
        return CameraSettings(self.exposure_us, self.analogue_gain)


class LightRecord(Record, frozen=True):
    """One light: position in the skin's frame (mm) and drive current (mA)."""

    name: ShortText
    colour: Literal["R", "G", "B"]
    position_mm: tuple[Coordinate, Coordinate, Coordinate]
    current_ma: Positive


class Fingerprint(Record, frozen=True):
    """Everything that determines the colour of a pixel.

    channel_order : the sensor's Bayer order as the profile states it; "as granted": that of the frames' own files
    orientation : direction of the raw frame's rows; the first row is the upper one
    lights : in R, G, B order
    exposure_us, analogue_gain : as granted
    """

    channel_order: StatedOrder
    orientation: Orientation
    lights: tuple[LightRecord, LightRecord, LightRecord]
    exposure_us: Positive
    analogue_gain: Positive

    @classmethod
    def of(cls, profile: BoardProfile, granted: CameraSettings, currents_ma: Mapping[str, float]) -> Fingerprint:
        """Return the fingerprint of a frame taken by this board with these settings and currents (mA)."""
        red, green, blue = (
            LightRecord(
                name=light.name,
                colour=light.colour,
                position_mm=light.position_mm,
                current_ma=currents_ma[light.name],
            )
            for light in profile.lights
        )
        return cls(
            channel_order=profile.sensor.bayer_order,
            orientation="rows-down",
            lights=(red, green, blue),
            exposure_us=granted.exposure_us,
            analogue_gain=granted.analogue_gain,
        )

    def mismatch(self, other: Fingerprint) -> str | None:
        """Return what differs, as a sentence (`self` is the calibration's, `other` the frame's), or None."""
        differences = [*self._setting_differences(other), *self._light_differences(other)]
        if not differences:
            return None
        return f"the calibration and the frame differ in {'; '.join(differences)}"

    def _setting_differences(self, other: Fingerprint) -> list[str]:
        found = [
            f"{what} ({mine}, not {theirs})"
            for what, mine, theirs in (
                ("channel order", self.channel_order, other.channel_order),
                ("orientation", self.orientation, other.orientation),
            )
            if mine != theirs
        ]
        if not _close(self.exposure_us, other.exposure_us):
            found.append(f"exposure ({self.exposure_us:g} µs, not {other.exposure_us:g} µs)")
        if not _close(self.analogue_gain, other.analogue_gain):
            found.append(f"gain ({self.analogue_gain:g}, not {other.analogue_gain:g})")
        return found

    def _light_differences(self, other: Fingerprint) -> list[str]:
        found = []
        for mine, theirs in zip(self.lights, other.lights, strict=True):
            if (mine.name, mine.colour) != (theirs.name, theirs.colour):
                found.append(f"lights ({mine.name} {mine.colour}, not {theirs.name} {theirs.colour})")
            elif math.dist(mine.position_mm, theirs.position_mm) > POSITION_TOLERANCE_MM:
                found.append(f"position of light {mine.name} ({mine.position_mm} mm, not {theirs.position_mm} mm)")
            elif not _close(mine.current_ma, theirs.current_ma):
                found.append(f"current of light {mine.name} ({mine.current_ma:g} mA, not {theirs.current_ma:g} mA)")
        return found


def _close(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=SETTING_TOLERANCE)
