"""The table of commands and the numerics, which it does not import, agree."""

from __future__ import annotations

import subprocess
import sys
from typing import get_args

from host_sync.calibration.calibrate import METHODS
from host_sync.cli.main import COMMANDS, app
from host_sync.cli.reconstruct import MethodName


def test_commands_know_every_method() -> None:
    assert get_args(MethodName) == METHODS


def test_every_command_is_found_by_its_name() -> None:
    assert [name for name in app if not name.startswith("-")] == [command.name for command in COMMANDS]
    assert all(command.summary for command in COMMANDS)


def test_reconstructing_with_a_kept_calibration_loads_only_what_it_needs() -> None:
    """Of scipy the transforms; the rest is for calibrating and takes as long to load as a reconstruction."""
    program = "import sys; from host_sync.reconstruction import scans; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert "scipy.fft" in loaded
    rest = {"scipy.linalg", "scipy.ndimage", "scipy.optimize", "scipy.interpolate", "scipy.spatial", "matplotlib"}
    assert not rest & set(loaded)
