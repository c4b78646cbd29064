"""The settings of a machine as Protocols, implemented by the real machine and by the twin's."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal, Protocol


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
        """Return the zone and state of the clock.

        Raises
        ------
        MachineError
            It cannot be read.
        """
        ...

    def zones(self) -> tuple[str, ...]:
        """Return names of all time zones. Errors as for `status`."""
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


Security = Literal["open", "password", "unsupported"]
"""What a Wi-Fi network asks for; "unsupported" are old WEP and networks with user accounts."""


@dataclass(frozen=True, slots=True)
class WifiNetwork:
    """A Wi-Fi network in range.

    signal : 0 to 1
    is_active : whether this machine is in it
    """

    name: str
    signal: float
    security: Security
    is_active: bool


class Wifi(Protocol):
    """The machine's Wi-Fi."""

    def active(self) -> str | None:
        """Name of the network that the machine is in; None: in none.

        Raises
        ------
        MachineError
            There is no Wi-Fi, or it cannot be asked.
        """
        ...

    def networks(self) -> tuple[WifiNetwork, ...]:
        """Return the networks in range, strongest first; takes some seconds. Errors as for `active`."""
        ...

    def join(self, network: WifiNetwork, password: str) -> None:
        """Join a network, and whenever it is in range from now on; takes up to a minute.

        password : empty for an open network

        Raises
        ------
        MachineError
            It was not joined; networks that were known stay as they were.
        """
        ...


@dataclass(frozen=True, slots=True)
class Machine:
    """All settings of the machine."""

    clock: SystemClockSetting
    backlight: Backlight
    wifi: Wifi
