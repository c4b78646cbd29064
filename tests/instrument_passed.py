"""Leave out the handheld's tests while nothing that they reach has changed since they passed.

`make test` gives the options that this module prints to pytest. The handheld's tests reach everything but the
workstation, for imports run one way; a clean clone, which has no stamp, runs them.

usage: python -m tests.instrument_passed state                 print the state of the files that those tests reach
       python -m tests.instrument_passed options STAMP STATE   print pytest's options
       python -m tests.instrument_passed passed STAMP STATE    every test passed that began in this state
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
HANDHELD_TESTS = ("tests/hal", "tests/device", "tests/board")
WORKSTATION = ("host_sync/", "tests/host_sync/")
UNKNOWN = "unknown"
"""State of files that git does not know, and of a run that `PYTEST_ADDOPTS` may have narrowed."""


def state_of(root: Path, files: Iterable[str]) -> str:
    """Return a digest of the files outside the workstation: names, contents and whether they may be run."""
    digest = hashlib.sha256()
    for name in sorted(file for file in files if not file.startswith(WORKSTATION)):
        path = root / name
        content, mode = (path.read_bytes(), path.stat().st_mode & 0o111) if path.is_file() else (b"", None)
        digest.update(f"{name} {mode} {hashlib.sha256(content).hexdigest()}\n".encode())
    return digest.hexdigest()


def options(stamp: Path, state: str) -> list[str]:
    """Return the options that leave out what passed in this state."""
    known = state != UNKNOWN and stamp.is_file()
    has_passed = known and stamp.read_text(encoding="utf-8") == state
    return [f"--ignore={folder}" for folder in HANDHELD_TESTS] if has_passed else []


def keep(stamp: Path, before: str, now: str) -> None:
    """Note that every test passed, unless the files changed meanwhile."""
    if before == now != UNKNOWN:
        stamp.write_text(now, encoding="utf-8")


def current_state() -> str:
    """Return the state of this checkout."""
    files = _files_of_project()
    narrowed = bool(os.environ.get("PYTEST_ADDOPTS"))
    return UNKNOWN if narrowed or "pyproject.toml" not in files else state_of(ROOT, files)


def _files_of_project() -> list[str]:
    """Return the files that git tracks or would track, by their place in the checkout; none without git."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    except (FileNotFoundError, subprocess.CalledProcessError):
        return []
    return [name for name in listed.stdout.split("\0") if name]


def main(step: str, stamp: str = "", state: str = "") -> None:
    """Print the state or the options, or keep the stamp."""
    if step == "state":
        sys.stdout.write(current_state())
    elif step == "passed":
        keep(Path(stamp), state, current_state())
    else:
        left_out = options(Path(stamp), state)
        if left_out:
            parts = ", ".join(HANDHELD_TESTS)
            sys.stderr.write(f"left out: {parts}: they passed, and only the workstation changed since (ALL=1: all)\n")
        sys.stdout.write(" ".join(left_out))


if __name__ == "__main__":
    main(*sys.argv[1:])
