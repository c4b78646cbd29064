"""OpenSSH's server on this machine, for tests that run it."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

SSHD = shutil.which("sshd", path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/usr/local/sbin") or "sshd"
"""Path of the server; where none is installed, a name that cannot be run."""

WITHOUT_SSHD = "OpenSSH's sshd is not installed: `make test-deps`"
needs_sshd = pytest.mark.skipif(shutil.which(SSHD) is None, reason=WITHOUT_SSHD)


def prepare_sshd() -> None:
    """Make the folder that a server of root starts in, which the system's own unit makes elsewhere."""
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)
