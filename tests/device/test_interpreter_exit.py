"""A program that has done its work does not end in a crash."""

from __future__ import annotations

import subprocess
import sys
from typing import Final

import pytest

SCRIPT: Final = """
import atexit, gc, sys
atexit.register(lambda freeze_count=gc.get_freeze_count: sys.stdout.write(str(freeze_count() > 1000)))
{work}
"""
WORK: Final = {
    "programs": "from host_sync.cli.start import main\nassert main(['--version']) == 0\nsys.stdout.write('|')",
    "the handheld's": "from device.cli.start import main\nassert main(['--version']) == 0\nsys.stdout.write('|')",
    "Python interface": "import host_sync.api_arguments\nsys.stdout.write('|')",
}


@pytest.mark.parametrize("name", WORK)
def test_what_is_left_at_the_end_is_not_collected(name: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(work=WORK[name])], capture_output=True, text=True, check=True
    )
    assert ended.stdout.rpartition("|")[2] == "True"
