"""Messages to the service manager (systemd): ready, alive, status, stopping. Without one nothing is sent.

Only the work loop feeds the watchdog, so that a hung loop goes silent and is restarted. The loop's owner calls
`device.cli.service.ServiceReport` in every turn and lets no turn wait longer than `longest_wait_s`.

Why not a library: the protocol is one datagram of text, see sd_notify(3).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

BEATS_PER_TIMEOUT: Final = 4
"""Four beats per watchdog timeout leave time for one long scan."""

SEND_TIMEOUT_S: Final = 1.0
"""Send timeout; a message that the service manager does not take in time is dropped, so that work never waits."""

POWER_OFF_FILE: Final = "poweroff"


class SdNotify:
    """The service manager behind a datagram socket.

    Parameters
    ----------
    address : of the socket, a path or an abstract name that begins with "@"; None without a service manager
    timeout_s : watchdog timeout; None without a watchdog
    folder : where a file named `poweroff` asks for power-off (`systemd/retrograph-poweroff.path`)
    """

    def __init__(self, address: str | None, timeout_s: float | None, folder: Path | None = None) -> None:
        self._address = address
        self._timeout_s = timeout_s if address else None
        self._folder = folder

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """Return the service manager that started this process, from its environment variables."""
        address = environment.get("NOTIFY_SOCKET") or None
        microseconds = environment.get("WATCHDOG_USEC", "")
        is_for_us = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        watches = is_for_us and microseconds.isdecimal() and int(microseconds) > 0
        folder = environment.get("RUNTIME_DIRECTORY")
        return cls(address, int(microseconds) * 1e-6 if watches else None, Path(folder) if folder else None)

    @property
    def longest_wait_s(self) -> float | None:
        """Longest time that one turn of the loop may wait, s; None without a watchdog."""
        return None if self._timeout_s is None else self._timeout_s / BEATS_PER_TIMEOUT

    def ready(self, status: str) -> None:
        """Report that the start is complete."""
        self._send(f"READY=1\nSTATUS={_one_line(status)}\nWATCHDOG=1")

    def status(self, status: str) -> None:
        """Report the present state, as `systemctl status` shows it."""
        self._send(f"STATUS={_one_line(status)}")

    def alive(self) -> None:
        """Feed the watchdog."""
        if self._timeout_s is not None:
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the work loop has ended."""
        self._send("STOPPING=1")

    def power_off(self) -> bool:
        """Ask for an orderly power-off; False if no service handles it."""
        if self._folder is None:
            return False
        try:
            (self._folder / POWER_OFF_FILE).touch()
        except OSError:
            return False
        return True

    def _send(self, message: str) -> None:
        """Send a message; a failure must not cost a scan."""
        if self._address is None:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as connection:
            connection.settimeout(SEND_TIMEOUT_S)
            connection.connect(address)
            connection.sendall(message.encode())


def _one_line(text: str) -> str:
    return " ".join(text.split())
