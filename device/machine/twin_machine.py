"""The twin's machine: settings in memory, so that a demonstration changes nothing of the computer it runs on."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from typing import Final

from device.errors import MachineError
from device.machine.interfaces import ClockStatus, Machine, WifiNetwork
from device.machine.real_machine import MIN_LEVEL


class TwinClock:
    """A time zone in memory; the twin's time runs by itself."""

    def __init__(self) -> None:
        self._status = ClockStatus("UTC", is_synchronized=False)

    def status(self) -> ClockStatus:
        """Return the zone that was set last."""
        return self._status

    def zones(self) -> tuple[str, ...]:
        """Return a few zones."""
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
        """Return the level that was set last."""
        return self._level

    def set_level(self, level: float) -> None:
        """Set the level."""
        self._level = min(max(level, MIN_LEVEL), 1.0)


TWIN_KEY: Final = "twin-password"


class TwinWifi:
    """Three networks in memory; the password of the one that needs it is `TWIN_KEY`."""

    def __init__(self) -> None:
        self._networks: tuple[WifiNetwork, ...] = (
            WifiNetwork("workshop", 0.8, "password", is_active=False),
            WifiNetwork("visitors", 0.5, "open", is_active=False),
            WifiNetwork("company", 0.3, "unsupported", is_active=False),
        )

    def active(self) -> str | None:
        """Return the network that was joined last."""
        return next((network.name for network in self._networks if network.is_active), None)

    def networks(self) -> tuple[WifiNetwork, ...]:
        """Return the three networks."""
        return self._networks

    def join(self, network: WifiNetwork, password: str) -> None:
        """Join one of them."""
        if network.security == "unsupported":
            raise MachineError(f"{network.name} needs a user account or is not safe: join another network")
        if network.security == "password" and password != TWIN_KEY:
            raise MachineError(f"the password of {network.name} is wrong: try again")
        self._networks = tuple(replace(one, is_active=one.name == network.name) for one in self._networks)


def twin_machine() -> Machine:
    """Return the machine of a simulated handheld."""
    return Machine(TwinClock(), TwinBacklight(), TwinWifi())
