"""A check that the root file system is as read-only as the kernel's command line asks."""

from __future__ import annotations

from pathlib import Path
from typing import Final

PROC = Path("/proc")
WRITABLE: Final = (
    "the root file system is writable although it is meant to be read-only: run install.sh --read-only again"
)
"""The initramfs had no overlay and went on without it: each power cut then meets files that are being written."""


def root_fault() -> str | None:
    """Return a sentence when an overlay was asked for and `/` is none, else None."""
    try:
        asked = (PROC / "cmdline").read_text(encoding="utf-8", errors="replace").split()
        mounts = (PROC / "self" / "mounts").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # no Linux
        return None
    if not any(word.startswith("overlayroot=") and word != "overlayroot=disabled" for word in asked):
        return None
    kinds = [fields[2] for line in mounts if len(fields := line.split()) > 2 and fields[1] == "/"]
    return None if kinds and kinds[-1] == "overlay" else WRITABLE
