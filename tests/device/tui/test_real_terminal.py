"""The screens in a real terminal: start, calibrate, three scans, review, quit, by the keys that a person presses."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Event

import pytest

ROOT = Path(__file__).parents[3]
MAX_LOOKS = 600
LOOK_EVERY_S = 0.1

pytestmark = pytest.mark.skipif(shutil.which("tmux") is None, reason="tmux is not installed (Debian: tmux)")


class Terminal:
    """A terminal of 80 x 24 in tmux, with a server of its own."""

    def __init__(self, socket: Path, command: list[str]) -> None:
        self._tmux = ("tmux", "-f", "/dev/null", "-S", str(socket), "-u")
        size = ("-x", "80", "-y", "24")
        then_stay = f"{shlex.join(command)}; echo ended with $?; exec cat"
        self._run("new-session", "-d", *size, "-c", str(ROOT), then_stay)

    def keys(self, *keys: str) -> None:
        self._run("send-keys", *keys)

    def text(self) -> str:
        return self._run("capture-pane", "-p")

    def wait_for(self, pattern: str) -> str:
        """The screen once it shows the pattern; it is looked at every tenth of a second, and not for ever."""
        for _ in range(MAX_LOOKS):
            if re.search(pattern, shown := self.text()):
                return shown
            Event().wait(LOOK_EVERY_S)
        pytest.fail(f"the terminal never showed {pattern!r}:\n{shown}")

    def process_id(self) -> str:
        """Of the shell in it."""
        return self._run("display-message", "-p", "#{pane_pid}").strip()

    def close(self) -> None:
        subprocess.run([*self._tmux, "kill-server"], check=False, capture_output=True)

    def _run(self, *arguments: str) -> str:
        done = subprocess.run([*self._tmux, *arguments], check=True, capture_output=True, text=True)
        return done.stdout


@pytest.fixture
def terminal(tmp_path: Path, small_board: Path) -> Iterator[Terminal]:
    command = [sys.executable, "-m", "device", "--board", str(small_board), "--store", str(tmp_path / "store")]
    opened = Terminal(tmp_path / "tmux", command)
    yield opened
    opened.close()


def test_calibrate_three_scans_review_quit(terminal: Terminal, tmp_path: Path) -> None:
    terminal.wait_for("Not calibrated: open Calibrate")
    terminal.keys("2")
    terminal.wait_for("Ball of 3 mm radius")
    terminal.keys("Space")
    terminal.wait_for("Touch nothing with the gel")
    for _ in range(12):
        terminal.wait_for(r"\d of 12")
        terminal.keys("Space")
    terminal.wait_for("Calibration passed and is active")
    terminal.keys("1")
    for number in range(1, 4):
        terminal.keys("d")
        terminal.keys("Space")
        terminal.wait_for(rf"(GOOD|DOUBTFUL|RETAKE) #{number} ")
    terminal.keys("3")
    shown = terminal.wait_for(r">\s+3 ")
    assert re.search(r"\s2 (good|doubtful)", shown)
    terminal.wait_for("µm")
    terminal.keys("g")
    terminal.wait_for(r">\s+3 \w+\s+good")
    terminal.keys("v")
    terminal.wait_for("This terminal has no graphics")
    terminal.keys("q")
    terminal.wait_for("ended with 0")
    assert len(list((tmp_path / "store" / "scans").iterdir())) == 3


def test_a_service_manager_ends_it_in_good_order(terminal: Terminal) -> None:
    terminal.wait_for("Not calibrated")
    shell = terminal.process_id()
    subprocess.run(["pkill", "-TERM", "-P", shell], check=True)
    terminal.wait_for("ended with 0")
