"""Every shell script of the project is one that shellcheck has nothing to say about."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHELLS = (b"#!/bin/bash", b"#!/bin/sh")
FOLDERS = ("board", "systemd", ".ci", "tests/system")
GOES_ON = {"agent"}
"""Of a virtual board: runs what it is told and says how that ended, so nothing that fails ends it."""


def shell_scripts() -> list[Path]:
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.is_file()]
    return sorted(path for path in files if path.suffix == ".sh" or path.read_bytes()[:64].startswith(SHELLS))


def test_the_scripts_are_found() -> None:
    names = {path.name for path in shell_scripts()}
    assert {
        "install.sh",
        "retrograph-slot",
        "first-boot",
        "usb-gadget",
        "run",
        "set-up",
        "build",
        "agent",
        "press",
    } <= names


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is not installed")
def test_shellcheck_has_nothing_to_say() -> None:
    ran = subprocess.run(["shellcheck", *shell_scripts()], capture_output=True, text=True, check=False)
    assert ran.stdout == ""


def test_scripts_stop_at_the_first_error() -> None:
    started = [path for path in shell_scripts() if path.read_bytes().startswith(SHELLS) and path.name not in GOES_ON]
    assert [path.name for path in started if "set -euo pipefail" not in path.read_text(encoding="utf-8")] == []
