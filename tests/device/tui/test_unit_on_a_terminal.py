"""What retroscan-tui.service runs, on a terminal and in an environment as the unit gives it: ready, drawn, ended."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import shlex
import shutil
import signal
import socket
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from unit_files import settings

UNIT = settings("retroscan-tui.service")
ROOT = Path(__file__).parents[3]
ROWS, COLUMNS = 30, 100
MAX_LOOKS = 600
LOOK_EVERY_S = 0.1


class Panel:
    """The unit's program on a pseudo terminal, with a service manager that listens."""

    def __init__(self, folder: Path, board: Path) -> None:
        self.manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.manager.bind(str(folder / "notify"))
        self.manager.settimeout(MAX_LOOKS * LOOK_EVERY_S)
        self._seen = bytearray()
        self._master, line = pty.openpty()
        fcntl.ioctl(line, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
        self.program = subprocess.Popen(
            ["setsid", "--ctty", *command(folder, board)],
            stdin=line,
            stdout=line,
            stderr=line,
            cwd=ROOT,
            env=environment(folder),
        )
        os.close(line)

    def message(self, wanted: str) -> str:
        """The next message to the service manager that contains this."""
        for _ in range(MAX_LOOKS):
            if wanted in (said := self.manager.recv(4096).decode()):
                return said
            self.read()
        pytest.fail(f"the program never sent {wanted!r}")

    def wait_for(self, text: str) -> str:
        """Everything that was written to the terminal, once the text is in it."""
        for _ in range(MAX_LOOKS):
            if text in (seen := self._seen.decode(errors="replace")):
                return seen
            self.read(LOOK_EVERY_S)
        pytest.fail(f"the terminal never showed {text!r}:\n{seen[-2000:]}")

    def read(self, timeout_s: float = 0.0) -> None:
        """Takes in what was written since, or the program would wait for it."""
        while select.select([self._master], [], [], timeout_s)[0]:
            try:
                self._seen += os.read(self._master, 1 << 16)
            except OSError:  # Linux's word for a terminal that nobody writes to any more
                return

    def ended(self) -> int:
        """With which code, once it has."""
        for _ in range(MAX_LOOKS):
            with suppress(subprocess.TimeoutExpired):
                return self.program.wait(LOOK_EVERY_S)
            self.read()
        pytest.fail("the program never ended")

    def close(self) -> None:
        self.program.kill()
        self.program.wait(60.0)
        os.close(self._master)
        self.manager.close()


def command(folder: Path, board: Path) -> list[str]:
    """The unit's, with this Python and store."""
    given = UNIT["ExecStart"][0].replace("${RETROSCAN_BOARD}", str(board))
    program, *arguments = shlex.split(given.replace("/var/lib/retroscan", str(folder / "store")))
    assert program == "/usr/local/bin/retroscan"
    return [sys.executable, "-m", "device", *arguments]


def environment(folder: Path) -> dict[str, str]:
    """The unit's environment alone, as systemd sets it for another terminal."""
    said = dict(word.split("=", 1) for line in UNIT["Environment"] for word in line.split())
    watchdog_us = str(int(UNIT["WatchdogSec"][0]) * 1_000_000)
    kept = {name: os.environ[name] for name in ("PATH", "HOME", "NUMBA_CACHE_DIR") if name in os.environ}
    kept["COLORTERM"] = "truecolor"
    for name in UNIT["UnsetEnvironment"]:
        kept.pop(name)
    return {**kept, **said, "NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": watchdog_us}


pytestmark = pytest.mark.skipif(shutil.which("setsid") is None, reason="setsid is not installed (Debian: util-linux)")


@pytest.fixture
def panel(tmp_path: Path, small_board: Path) -> Iterator[Panel]:
    opened = Panel(tmp_path, small_board)
    yield opened
    opened.close()


def test_the_units_program_draws_is_ready_feeds_its_watchdog_and_ends_in_order(panel: Panel) -> None:
    assert "STATUS=no scans yet: no calibration is active" in panel.message("READY=1")
    drawn = panel.wait_for("Not calibrated: open Calibrate")
    assert "Set-up" in drawn
    assert "38;2;" not in drawn, "a plain console has sixteen colours"
    panel.message("WATCHDOG=1")
    panel.program.send_signal(signal.Signals[UNIT["KillSignal"][0]])
    panel.message("STOPPING=1")
    assert panel.ended() in {0, int(UNIT["SuccessExitStatus"][0])}
    panel.wait_for("\x1b[?1049l")
