"""A program that has done its work does not end in a crash."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

SCRIPT: Final = """
import atexit, gc, sys
atexit.register(lambda freeze_count=gc.get_freeze_count: sys.stdout.write('|' + str(freeze_count() > 1000)))
{work}
"""
WORK: Final = {
    "the workstation's program": "from host_sync.__main__ import main\nmain(['verify', '--library', 'absent'])",
    "the handheld's program": "from device.__main__ import main\nmain(['--board', 'twin', '--store', 'new', 'list'])",
    "the Python interface": "import host_sync.api_arguments",
    "records": "import host_sync.frames.frame_set",
}


@pytest.mark.parametrize("name", WORK)
def test_what_is_left_at_the_end_is_not_collected(name: str, tmp_path: Path) -> None:
    program = [sys.executable, "-c", SCRIPT.format(work=WORK[name])]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    ended = subprocess.run(program, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    assert ended.stdout.endswith("|True")
