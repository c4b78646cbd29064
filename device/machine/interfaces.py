"""The settings of a machine as Protocols, implemented by the real machine and by the twin's."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Protocol


@dataclass(frozen=True, slots=True)
class ClockStatus:
    """The system's clock.

    time_zone : such as "Europe/Berlin"
    is_synchronized : whether a time server has confirmed the time since the machine was switched on
    """

    time_zone: str
    is_synchronized: bool


class SystemClockSetting(Protocol):
    """The system's clock and time zone."""

    def status(self) -> ClockStatus:
        """Zone and state of the clock.

        Raises
        ------
        MachineError
            It cannot be read.
        """
        ...

    def zones(self) -> tuple[str, ...]:
        """Names of all time zones. Errors as for `status`."""
        ...

    def set_time(self, local: datetime) -> None:
        """Set date and time, without a zone: as clocks at this place show it.

        Raises
        ------
        MachineError
            It cannot be set.
        """
        ...

    def set_zone(self, name: str) -> None:
        """Set the time zone. Errors as for `set_time`."""
        ...


class Backlight(Protocol):
    """Brightness of the instrument's own panel."""

    def level(self) -> float | None:
        """Present brightness, 0 to 1; None: this machine has no panel whose brightness can be set.

        Raises
        ------
        MachineError
            It cannot be read.
        """
        ...

    def set_level(self, level: float) -> None:
        """Set the brightness, 0 to 1; never so dark that nothing can be read. Errors as for `level`."""
        ...


@dataclass(frozen=True, slots=True)
class Machine:
    """All settings of the machine."""

    clock: SystemClockSetting
    backlight: Backlight
