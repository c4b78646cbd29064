"""Leave out the handheld's tests while nothing that they reach has changed since they passed.

`make test` gives the options that this module prints to pytest. The handheld's tests reach everything but the
workstation, for imports run one way; a clean clone, which has no stamp, runs them.

usage: python -m tests.instrument_passed STAMP          print pytest's options; note the state of the files beside STAMP
       python -m tests.instrument_passed STAMP passed   every test passed in the state that was noted
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
HANDHELD_TESTS = ("tests/hal", "tests/device", "tests/board")
WORKSTATION = ("host_sync/", "tests/host_sync/")


def state_of(root: Path, files: Iterable[str]) -> str:
    """Return a digest of the files outside the workstation, names and contents; a file that is gone has none."""
    digest = hashlib.sha256()
    for name in sorted(file for file in files if not file.startswith(WORKSTATION)):
        path = root / name
        content = path.read_bytes() if path.is_file() else b"none"
        digest.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    return digest.hexdigest()


def options(stamp: Path, state: str | None) -> list[str]:
    """Return the options that leave out what passed in this state, and note the state; None is an unknown state."""
    noted = _noted(stamp)
    noted.unlink(missing_ok=True)
    if state is None:
        return []
    noted.write_text(state, encoding="utf-8")
    has_passed = stamp.is_file() and stamp.read_text(encoding="utf-8") == state
    return [f"--ignore={folder}" for folder in HANDHELD_TESTS] if has_passed else []


def keep(stamp: Path) -> None:
    """Note that every test passed in the state that `options` saw."""
    if _noted(stamp).is_file():
        _noted(stamp).replace(stamp)


def _noted(stamp: Path) -> Path:
    return stamp.with_name(f"{stamp.name}.noted")


def files_of_project() -> list[str] | None:
    """Return the files that git tracks or would track, by their place in the checkout; None without git."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    except (FileNotFoundError, subprocess.CalledProcessError):
        return None
    return [name for name in listed.stdout.split("\0") if name]


def main() -> None:
    """Print the options, or keep the stamp."""
    stamp = Path(sys.argv[1])
    if sys.argv[2:] == ["passed"]:
        keep(stamp)
        return
    files = files_of_project()
    left_out = options(stamp, None if files is None else state_of(ROOT, files))
    if left_out:
        parts = ", ".join(HANDHELD_TESTS)
        sys.stderr.write(f"left out: {parts}, which passed; only the workstation has changed since (ALL=1 runs them)\n")
    sys.stdout.write(" ".join(left_out))


if __name__ == "__main__":
    main()
