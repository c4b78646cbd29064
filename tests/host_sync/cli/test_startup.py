"""Commands that fetch, search and verify start light: the numerics are loaded by those that reconstruct."""

from __future__ import annotations

import subprocess
import sys
from typing import get_args

from host_sync.calibration.calibrate import METHODS
from host_sync.cli.reconstruct import MethodName

HEAVY = ("numba", "scipy", "matplotlib", "asyncssh", "zeroconf")


def test_the_command_line_loads_no_numerics() -> None:
    said = subprocess.run(
        [sys.executable, "-c", "import sys, host_sync.cli.main; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert set(HEAVY).isdisjoint(said.stdout.split())


def test_commands_know_every_method() -> None:
    assert get_args(MethodName) == METHODS
