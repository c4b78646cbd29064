"""A workstation pairs with a guest: both show a code, it is typed on the guest, and the workstation agrees."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Protocol

from virtual_machine import PAIRING

CODE = re.compile(r"Code (\d{3} \d{3})")
OPEN = """
. /etc/default/retroscan
mkfifo -m 666 /run/typed 2>/dev/null
runuser -u retroscan -- /usr/local/bin/retroscan --board "$RETROSCAN_BOARD" --store /var/lib/retroscan pair \
    <>/run/typed >/run/paired 2>&1 &
sleep 1
"""


class Guest(Protocol):
    """A machine that runs scripts."""

    ports: dict[int, int]

    def run(self, script: str, timeout_s: float = ...) -> str: ...
    def wait_for(self, script: str, timeout_s: float = ...) -> str: ...


def pair_with(guest: Guest, tree: Path) -> str:
    """Pair this user's workstation with the guest; returns the device's id."""
    guest.run(OPEN)
    guest.wait_for("grep -q '^This device' /run/paired")
    calling = subprocess.Popen(
        [sys.executable, "-u", "-m", "host_sync", "pair", "127.0.0.1", "--port", str(guest.ports[PAIRING])],
        cwd=tree, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    shown = CODE.search(guest.wait_for("grep -oE 'Code [0-9]{3} [0-9]{3}' /run/paired"))
    assert shown
    guest.run(f"sleep 1; echo {shown[1]} >/run/typed")
    said, _ = calling.communicate("yes\n", timeout=120.0)
    here, device = CODE.search(said), re.search(r"Paired with (\S+) at", said)
    assert here, said
    assert here[1] == shown[1], "both sides show the same code"
    assert calling.returncode == 0, said
    assert device, said
    return device[1]
