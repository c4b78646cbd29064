"""A terminal that vanishes ends the screens, whether the system sends a hang-up signal or not, and lights are off."""

import os
import pty
import select
import subprocess
import sys
from pathlib import Path

import pytest

MAX_S = 25.0

WITH_HANG_UP = "import fcntl, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0)"
WITHOUT = "pass"

PROGRAM = """
{start}
import sys
from device.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("start", [WITH_HANG_UP, WITHOUT], ids=["hang-up", "silent"])
def test_the_program_ends_when_its_terminal_is_gone(start: str, small_board: Path, calibrated_root: Path) -> None:
    master, slave = pty.openpty()
    command = [sys.executable, "-c", PROGRAM.format(start=start)]
    arguments = ["--board", str(small_board), "--store", str(calibrated_root)]
    running = subprocess.Popen(
        [*command, *arguments],
        stdin=slave,
        stdout=subprocess.DEVNULL,
        stderr=slave,
        start_new_session=True,
        env={**os.environ, "TERM": "xterm-256color"},
    )
    os.close(slave)
    try:
        seen = b""
        while b"Set-up" not in seen:
            assert select.select([master], [], [], MAX_S)[0], seen
            seen += os.read(master, 65536)
        os.close(master)
        running.wait(MAX_S)
    finally:
        running.kill()
    assert running.returncode >= 0, "it was killed by the hang-up instead of ending in order"
