"""`retroscan` and `retroscan tui`: what they need, and what powering off asks of the machine."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from device.cli.screens import power_off
from device.errors import StoreError

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("command", [(), ("tui",)])
def test_without_a_terminal_the_way_on_is_said(tmp_path: Path, command: tuple[str, ...]) -> None:
    arguments = [sys.executable, "-m", "device", "--board", "twin", "--store", str(tmp_path / "store"), *command]
    done = subprocess.run(arguments, cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("retroscan: the screens need a terminal")
    assert not (tmp_path / "store").exists()


def test_only_the_screens_need_textual() -> None:
    """Scanning without a screen must not wait for it."""
    program = "import sys, device.cli.main; sys.exit('textual' in sys.modules or 'rich' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=False).returncode == 0


def test_powering_off_leaves_the_request_where_the_system_looks(tmp_path: Path) -> None:
    power_off(tmp_path)
    assert (tmp_path / "poweroff").exists()


def test_a_machine_that_is_no_handheld_says_so(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="switch it off by hand"):
        power_off(tmp_path / "absent")
