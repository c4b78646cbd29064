"""Programs of the system as small executables that write down how they were called, and answer as the test says."""

from collections.abc import Callable
from pathlib import Path

import pytest

Fake = Callable[[str, str], Path]


@pytest.fixture
def calls(tmp_path: Path) -> Callable[[], list[str]]:
    """The calls of all fake programs so far: one line of arguments each."""

    def read() -> list[str]:
        path = tmp_path / "calls"
        return path.read_text(encoding="utf-8").splitlines() if path.exists() else []

    return read


@pytest.fixture
def fake(tmp_path: Path) -> Fake:
    """`fake(name, script)` makes an executable of a shell script; `$log` is a file for its input."""

    def make(name: str, script: str) -> Path:
        path = tmp_path / name
        path.write_text(f'#!/bin/sh\nlog={tmp_path}/input\necho "$*" >>{tmp_path}/calls\n{script}\n', encoding="utf-8")
        path.chmod(0o755)
        return path

    return make
