"""What a service manager is told: ready, still alive, about to stop. Without one, nobody is told and nothing fails.

The watchdog is fed by the loop that does the work, and by nothing else: a loop that hangs falls silent, and is started
again. Whoever runs such a loop (`device.session.headless`, the screen) makes one `Supervisor.from_environment`, has
`device.session.service_report` call it in every turn, and lets no turn wait longer than `longest_wait_s`.

Why an own module: the protocol is one datagram of text, see sd_notify(3).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

BEATS_PER_TIMEOUT: Final = 4
"""A quarter of the watchdog's time between two beats leaves room for one long scan."""

PATIENCE_S: Final = 1.0
"""A service manager that does not take a message within this time goes without it: work never waits for it."""

POWER_OFF_FILE: Final = "poweroff"


class Supervisor:
    """The service manager behind a datagram socket.

    Parameters
    ----------
    address : of the socket, a path or a name in the abstract namespace that begins with "@"; None when there is none
    timeout_s : silence after which the service manager ends the program; None when it does not watch
    folder : where a file named `poweroff` is a wish that it grants (`systemd/retrograph-poweroff.path`)
    """

    def __init__(self, address: str | None, timeout_s: float | None, folder: Path | None = None) -> None:
        self._address = address
        self._timeout_s = timeout_s if address else None
        self._folder = folder

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """The one that started this very process, as its environment says."""
        address = environment.get("NOTIFY_SOCKET") or None
        microseconds = environment.get("WATCHDOG_USEC", "")
        is_meant = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        watches = is_meant and microseconds.isdecimal() and int(microseconds) > 0
        folder = environment.get("RUNTIME_DIRECTORY")
        return cls(address, int(microseconds) * 1e-6 if watches else None, Path(folder) if folder else None)

    @property
    def longest_wait_s(self) -> float | None:
        """The longest that a turn of the loop may wait, s; None when nobody watches."""
        return None if self._timeout_s is None else self._timeout_s / BEATS_PER_TIMEOUT

    def ready(self, status: str) -> None:
        """The start is over."""
        self._tell(f"READY=1\nSTATUS={_one_line(status)}\nWATCHDOG=1")

    def status(self, status: str) -> None:
        """How things stand now; `systemctl status` shows it."""
        self._tell(f"STATUS={_one_line(status)}")

    def alive(self) -> None:
        """Another turn of the work loop was done."""
        if self._timeout_s is not None:
            self._tell("WATCHDOG=1")

    def stopping(self) -> None:
        """The work loop has ended."""
        self._tell("STOPPING=1")

    def power_off(self) -> bool:
        """Ask for an orderly end of the whole device; False when there is nobody to ask."""
        if self._folder is None:
            return False
        try:
            (self._folder / POWER_OFF_FILE).touch()
        except OSError:
            return False
        return True

    def _tell(self, message: str) -> None:
        """Send; a service manager that has gone must not cost a scan."""
        if self._address is None:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as telling:
            telling.settimeout(PATIENCE_S)
            telling.connect(address)
            telling.sendall(message.encode())


def _one_line(text: str) -> str:
    return " ".join(text.split())
