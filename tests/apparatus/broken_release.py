"""A release that differs from another in its version and in one defect, for testing updates."""

from __future__ import annotations

import re
import shutil
import zipfile
from pathlib import Path

ENTRY = "device/cli/instrument_commands.py"
SELF_TEST, INSTRUMENT = "check_parts", "run"
"""Functions of the commands that an update must pass."""


def release_with(good: Path, folder: Path, version: str, function: str, first_line: str) -> Path:
    """Make a release folder at `folder` whose wheel has another version, and a new first line in one function of the
    program.

    function : its name, such as `SELF_TEST`
    """
    shutil.copytree(good, folder, ignore=shutil.ignore_patterns("retrograph-*.whl"))
    wheel = next(good.glob("retrograph-*.whl"))
    old = wheel.name.split("-")[1]
    with (
        zipfile.ZipFile(wheel) as source,
        zipfile.ZipFile(folder / wheel.name.replace(old, version), "w", zipfile.ZIP_DEFLATED) as target,
    ):
        for name in source.namelist():
            content = source.read(name)
            if name == ENTRY:
                content = spoiled(content.decode(), function, first_line).encode()
            elif name.endswith(".dist-info/METADATA"):
                content = content.replace(f"\nVersion: {old}\n".encode(), f"\nVersion: {version}\n".encode())
            elif name.endswith(".dist-info/RECORD"):
                content = content.replace(f"-{old}.dist-info".encode(), f"-{version}.dist-info".encode())
            target.writestr(name.replace(f"-{old}.dist-info", f"-{version}.dist-info"), content)
    return folder


def spoiled(text: str, function: str, first_line: str) -> str:
    """Return the text of `ENTRY` with a new first line in one function."""
    definition = re.search(rf"^def {function}\(.*?\) -> int:\n", text, re.MULTILINE | re.DOTALL)
    if definition is None:
        raise ValueError(f"{ENTRY} has no {function!r}")
    return text[: definition.end()] + first_line + text[definition.end() :]
