"""The machine that the program runs on with its panel's backlight, and the twin's machine.

The twin's settings are in memory, so that a demonstration changes nothing of the computer it runs on.
"""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Final

from device.errors import MachineError
from device.machine.interfaces import ClockStatus, Machine, WifiNetwork
from device.machine.wifi import NetworkManagerWifi, ProgramFailed, run_program

NOT_ALLOWED: Final = ("Access denied", "authentication required", "not authorized", "Permission denied")


class TimedateClock:
    """The clock that systemd's timedated sets.

    Parameters
    ----------
    program : timedatectl, by name or path
    """

    def __init__(self, program: str = "timedatectl") -> None:
        self._program = program

    def status(self) -> ClockStatus:
        """Return the zone and state; errors as for `SystemClockSetting.status`."""
        facts = dict(line.partition("=")[::2] for line in self._run("show").splitlines())
        return ClockStatus(facts.get("Timezone") or "unknown", facts.get("NTPSynchronized") == "yes")

    def zones(self) -> tuple[str, ...]:
        """Return names of all time zones."""
        return tuple(self._run("list-timezones").split())

    def set_time(self, local: datetime) -> None:
        """Set the time; time servers, which would forbid it, are left alone for that moment and asked again."""
        self._run("set-ntp", "false")
        try:
            self._run("set-time", f"{local:%Y-%m-%d %H:%M:%S}")
        finally:
            self._run("set-ntp", "true")

    def set_zone(self, name: str) -> None:
        """Set the time zone, also of this program."""
        self._run("set-timezone", name)
        time.tzset()

    def _run(self, *arguments: str) -> str:
        try:
            return run_program([self._program, "--no-pager", "--no-ask-password", *arguments])
        except ProgramFailed as error:
            if any(words.casefold() in error.said.casefold() for words in NOT_ALLOWED):
                raise MachineError(
                    "this user may not set the clock: run board/install.sh again, which installs the rule for it"
                ) from error
            raise MachineError(f"the clock cannot be read or set: {error.said}") from error


def real_machine() -> Machine:
    """Clock, panel and Wi-Fi of this machine; nothing is asked before its first use."""
    return Machine(TimedateClock(), SysfsBacklight(), NetworkManagerWifi())


# Brightness of the panel through the kernel's backlight files; a udev rule lets the instrument's user write them.

BACKLIGHTS: Final = Path("/sys/class/backlight")

MIN_LEVEL: Final = 0.05
"""Darkest level that is set: at 0 many panels are black, and nobody could find the way back."""


class SysfsBacklight:
    """The first backlight of this machine.

    Parameters
    ----------
    folder : of the kernel's backlights
    """

    def __init__(self, folder: Path = BACKLIGHTS) -> None:
        self._folder = folder

    def level(self) -> float | None:
        """Present brightness; None without a backlight. Errors as for `Backlight.level`."""
        panel = self._panel()
        return None if panel is None else _number(panel / "brightness") / self._brightest(panel)

    def set_level(self, level: float) -> None:
        """Set the brightness, from `MIN_LEVEL` to 1.

        Raises
        ------
        MachineError
            There is no backlight, or it cannot be written.
        """
        panel = self._panel()
        if panel is None:
            raise MachineError("this machine has no panel whose brightness can be set")
        steps = max(round(min(max(level, MIN_LEVEL), 1.0) * self._brightest(panel)), 1)
        try:
            (panel / "brightness").write_text(f"{steps}\n", encoding="ascii")
        except PermissionError as error:
            raise MachineError(
                f"{panel / 'brightness'}: this user may not write it: run board/install.sh again for its rule"
            ) from error
        except OSError as error:
            raise MachineError(f"{panel / 'brightness'}: cannot be written ({error.strerror})") from error

    def _panel(self) -> Path | None:
        try:
            panels = sorted(self._folder.iterdir())
        except OSError:
            return None
        return panels[0] if panels else None

    @staticmethod
    def _brightest(panel: Path) -> int:
        brightest = _number(panel / "max_brightness")
        if brightest < 1:
            raise MachineError(f"{panel / 'max_brightness'}: {brightest} is no brightness")
        return brightest


def _number(path: Path) -> int:
    try:
        return int(path.read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        raise MachineError(f"{path}: cannot be read as a number") from error


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
