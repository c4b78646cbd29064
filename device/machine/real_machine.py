"""The machine that the program runs on."""

from __future__ import annotations

import time
from datetime import datetime
from typing import Final

from device.errors import MachineError
from device.machine.backlight import SysfsBacklight
from device.machine.interfaces import ClockStatus, Machine
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
