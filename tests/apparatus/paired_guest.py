"""A workstation pairs with a guest: both show a code, a person confirms it on the guest, and the workstation agrees."""

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


def pair_by_typing(guest: Guest, tree: Path) -> str:
    """Pair this user's workstation with a guest whose code is typed into `retroscan pair`; returns the device's id."""
    guest.run(OPEN)
    guest.wait_for("grep -q '^This device' /run/paired")
    return _call(guest, tree, "cat /run/paired", "echo {code} >/run/typed")


def pair_by_button(guest: Guest, tree: Path) -> str:
    """Pair with a guest whose held button opens the window of its running instrument and confirms the code."""
    journal = "journalctl -b -u retroscan -o cat --no-pager"
    guest.wait_for(f"{journal} | grep 'the window is closed'")  # it was opened at the start, as for every new device
    before = int(guest.run(f"{journal} | wc -l"))
    said, push = f"{journal} | tail -n +{before + 1}", "/usr/local/lib/virtual/press 2.5"
    guest.run(push)
    guest.wait_for(f"{said} | grep '^This device'")
    return _call(guest, tree, said, push)


def _call(guest: Guest, tree: Path, said: str, confirm: str) -> str:
    """Call the open window, compare the codes, and confirm on both sides.

    said : script that prints what the device shows
    confirm : script that confirms `{code}` there
    """
    calling = subprocess.Popen(
        [sys.executable, "-u", "-m", "host_sync", "pair", "127.0.0.1", "--port", str(guest.ports[PAIRING])],
        cwd=tree, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    shown = CODE.search(guest.wait_for(f"{said} | grep -oE 'Code [0-9]{{3}} [0-9]{{3}}'"))
    assert shown
    guest.run(f"sleep 1; {confirm.format(code=shown[1])}")
    answer, _ = calling.communicate("yes\n", timeout=120.0)
    here, device = CODE.search(answer), re.search(r"Paired with (\S+) at", answer)
    assert here, answer
    assert here[1] == shown[1], "both sides show the same code"
    assert calling.returncode == 0, answer
    assert device, answer
    return device[1]
