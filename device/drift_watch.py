"""How the lights have changed since calibration, from whatever untouched skin was seen on the way."""

from __future__ import annotations

from typing import Final

from device.rest_sight import RestSight

LARGEST_STEP: Final = 0.012
"""Skin beside a press is believed while no light differs by more from the last whole field at rest, or from the last
sight while there was none; larger steps want a whole field at rest."""


class DriftWatch:
    """The last believed levels of the lights."""

    def __init__(self) -> None:
        self._levels = (1.0, 1.0, 1.0)
        self._whole: tuple[float, float, float] | None = None
        self._seen = False
        self._pattern: float | None = None
        self._unseen_scans = 0

    @property
    def changes(self) -> tuple[float, float, float] | None:
        """Relative change of each light since calibration, R, G, B; None before the first sight."""
        red, green, blue = self._levels
        return (red - 1.0, green - 1.0, blue - 1.0) if self._seen else None

    @property
    def pattern(self) -> float | None:
        """Change of the resting skin's pattern at the last sight of the whole field, root mean square; None before."""
        return self._pattern

    @property
    def unseen_scans(self) -> int:
        """Scans since the last sight."""
        return self._unseen_scans

    def see(self, sight: RestSight | None) -> bool:
        """Take a sight in, and say whether it is believed."""
        if sight is None or sight.is_tilt:
            return False
        before = self._whole or self._levels
        step = max(abs(new - old) for new, old in zip(sight.levels, before, strict=True))
        if not sight.is_whole and step > LARGEST_STEP:
            return False
        self._levels, self._seen, self._unseen_scans = sight.levels, True, 0
        if sight.is_whole:
            self._whole, self._pattern = sight.levels, sight.pattern
        return True

    def scanned(self, sight: RestSight | None) -> None:
        """A scan was taken, and showed so much."""
        if not self.see(sight):
            self._unseen_scans += 1
