"""The twin's machine: settings in memory, so that a demonstration changes nothing of the computer it runs on."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

from device.errors import MachineError
from device.machine.backlight import MIN_LEVEL
from device.machine.interfaces import ClockStatus, Machine


class TwinClock:
    """A time zone in memory; the twin's time runs by itself."""

    def __init__(self) -> None:
        self._status = ClockStatus("UTC", is_synchronized=False)

    def status(self) -> ClockStatus:
        """The zone that was set last."""
        return self._status

    def zones(self) -> tuple[str, ...]:
        """A few zones."""
        return ("America/New_York", "Asia/Tokyo", "Europe/Berlin", "Europe/London", "UTC")

    def set_time(self, local: datetime) -> None:
        """Refuse it: the twin follows the computer's clock."""
        raise MachineError(f"the twin follows this computer's clock: it was not set to {local:%Y-%m-%d %H:%M}")

    def set_zone(self, name: str) -> None:
        """Set the zone that `status` shows."""
        self._status = replace(self._status, time_zone=name)


class TwinBacklight:
    """A brightness in memory."""

    def __init__(self) -> None:
        self._level = 1.0

    def level(self) -> float | None:
        """The level that was set last."""
        return self._level

    def set_level(self, level: float) -> None:
        """Set the level."""
        self._level = min(max(level, MIN_LEVEL), 1.0)


def twin_machine() -> Machine:
    """The machine of a simulated handheld."""
    return Machine(TwinClock(), TwinBacklight())
