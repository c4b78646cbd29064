"""The handheld with a screen: retroscan-tui.service on the virtual board's first virtual terminal.

After test_virtual_board_mishaps.py, which switched the machine off; or alone, on a machine that is then set up for it.
What stands on the screen is what the kernel keeps of that terminal, in /dev/vcs1: there is no display to draw it on.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from virtual_board import INSTALL, LEDOUT0, PATIENCE, PROGRAM, PUSHING, SHARES, Board, register

pytestmark = pytest.mark.system

SCREEN = "tr '\\0' ' ' </dev/vcs1 | fold -w 80"
MAX_LIT_S = 120.0
WITH_SCREEN = """
mkdir -p /etc/systemd/system/retroscan-tui.service.d
printf '[Service]\\nTimeoutStartSec=600\\nTimeoutStopSec=300\\nWatchdogSec=300\\n' \
    >/etc/systemd/system/retroscan-tui.service.d/patience.conf
systemctl --quiet unmask getty@.service
systemctl --quiet disable retroscan
systemctl --quiet enable retroscan-tui
"""
WITHOUT_SCREEN = """
systemctl --quiet disable retroscan-tui
systemctl --quiet enable retroscan
systemctl --quiet mask getty@.service
"""
"""The units alone: install.sh --screen panel asks for fonts, which this board has no network to fetch from."""


@pytest.fixture(scope="module")
def panel(board: Board) -> Iterator[Board]:
    """The board, started with its screen; switched off in the end, as it was."""
    machine = board.machine
    if not machine.is_on:
        machine.switch_on()
        machine.wait_for("systemctl is-active retroscan")
    machine.run(f"mountpoint -q /mnt/source || {{ {SHARES} }}")
    if machine.ask("test -L /usr/local/bin/retroscan").code:
        with board.stage("install.sh, for the screen"):
            machine.run(INSTALL + PATIENCE)
    machine.run(WITH_SCREEN)
    with board.stage("reboot until the screen is ready"):
        machine.reboot()
        machine.wait_for("systemctl is-active retroscan-tui")
    yield board
    machine.run(WITHOUT_SCREEN)
    machine.power_off()


def test_a_boot_ends_on_the_screen(panel: Board) -> None:
    """In the place of a login prompt and of the headless instrument, at the first start."""
    machine = panel.machine
    machine.wait_for(f"{SCREEN} | grep Set-up")
    assert {"Scan", "Calibrate", "Scans"} <= set(machine.run(SCREEN).split())
    assert machine.run("systemctl show -P NRestarts retroscan-tui").strip() == "0"
    assert re.match("ready: room for|no scans yet: no calibration", status(panel))
    for other in ("retroscan", "getty@tty1"):
        assert machine.ask(f"systemctl is-active {other}").code != 0, other
    owner = "ps -o tty= -o user:20= -p $(systemctl show -P MainPID retroscan-tui)"
    assert machine.run(owner).split() == ["tty1", "retroscan"]


def test_the_camera_never_has_two_owners(panel: Board) -> None:
    """Whoever comes by another door is refused; of the two units each waits until the other has ended."""
    machine = panel.machine
    refused = machine.ask(f"{PROGRAM} selftest")
    assert refused.code != 0
    assert "the instrument is in use by process" in refused.text
    with panel.stage("from the screen to the headless instrument and back"):
        for unit, other in (("retroscan", "retroscan-tui"), ("retroscan-tui", "retroscan")):
            machine.run(f"systemctl start {unit}")
            assert machine.ask(f"systemctl is-active {other}").code != 0
            assert machine.run(f"systemctl show -P NRestarts {unit}").strip() == "0"


def test_a_push_scans_behind_the_screen(panel: Board) -> None:
    """`wait_for` fails unless one more scan is stored and its verdict is shown."""
    machine, scans = panel.machine, "(ls /data/store/scans 2>/dev/null || true) | wc -l"
    if status(panel).startswith("no scans yet"):
        with panel.stage("calibration, for the screen"):
            machine.run(f"systemctl stop retroscan-tui; {PUSHING} {PROGRAM} calibrate")
            machine.run("systemctl start retroscan-tui")
    machine.wait_for("systemctl show -P StatusText retroscan-tui | grep '^ready: room for'")
    before = int(machine.run(scans))
    with panel.stage("push to scan behind the screen"):
        machine.run("/usr/local/lib/virtual/press")
        machine.wait_for(f"test $({scans}) = {before + 1}")
    machine.wait_for(f"{SCREEN} | grep -E 'GOOD|DOUBTFUL|RETAKE'")


def test_the_lights_are_dark_once_the_screen_has_ended(panel: Board) -> None:
    outputs = register(LEDOUT0, 4)
    panel.machine.run("/usr/local/lib/virtual/press")
    panel.machine.wait_for(f"{outputs} | grep '[1-9]'", MAX_LIT_S)
    panel.machine.run("systemctl stop retroscan-tui")
    assert panel.machine.run(outputs).split() == ["0"] * 4
    assert panel.machine.run("systemctl show -P Result retroscan-tui").strip() == "success"


def status(panel: Board) -> str:
    return panel.machine.run("systemctl show -P StatusText retroscan-tui")
