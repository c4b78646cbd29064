"""The whole handheld on a virtual board, in use: installed, tested, calibrated, scanned with, pulled from.

One machine; its tests build on one another in this order, as somebody would use it, and go on in
test_virtual_board_mishaps.py. What it shows and what it cannot is in docs/system-tests.md.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from paired_guest import pair_by_button
from virtual_board import INSTALL, PATIENCE, PROGRAM, PUSHING, PWM_ALL, SHARES, STATUS, Board, register, replug
from virtual_machine import SSH

from device.bundles.scan import read_scan

pytestmark = pytest.mark.system

TREE = Path(__file__).parents[2]
MAX_EXPOSED = 2.5
"""Of `systemd-analyze security`."""


def test_install_goes_on_after_an_interruption_and_is_idempotent(board: Board) -> None:
    with board.stage("install.sh, killed"):
        assert board.machine.ask(f"timeout --signal KILL 20 {INSTALL}").code == 137
    with board.stage("install.sh"):
        assert "Done." in board.machine.run(INSTALL)
    assert board.machine.run(INSTALL).splitlines()[-1] == "Everything is in place."
    assert board.machine.run("findmnt -n -o FSTYPE /data").strip() == "ext4"
    board.machine.run(PATIENCE)


def test_after_a_reboot_only_the_calibration_is_missing(board: Board) -> None:
    with board.stage("reboot until the instrument is ready"):
        board.machine.reboot()
        board.machine.wait_for("systemctl is-active retroscan")
    board.machine.run(SHARES)
    assert board.machine.run("findmnt -n -o SOURCE /data; findmnt -n -o TARGET /var/lib/retroscan").split() == [
        "/dev/vdb",
        "/var/lib/retroscan",
    ]
    assert "no scans yet: no calibration is active" in board.machine.run("journalctl -b -u retroscan -o cat --no-pager")
    assert board.machine.run(STATUS).startswith("no scans yet: no calibration is active")
    board.machine.run("systemctl stop retroscan")


def test_every_service_is_shut_in_as_this_systemd_counts_it(board: Board) -> None:
    """The one of Debian trixie; `make test` asks the one of the machine that it runs on."""
    told = board.machine.run(
        "cd /etc/systemd/system; "
        "for unit in retro*.service; do systemd-analyze security --no-pager $unit | tail -n 1; done"
    )
    exposed = {line.split()[-4].rstrip(":"): float(line.split()[-3]) for line in told.splitlines()}
    assert len(exposed) == len(list((TREE / "systemd").glob("*.service")))
    assert {unit: level for unit, level in exposed.items() if level > MAX_EXPOSED} == {}


def test_the_self_test_drives_bus_and_lines(board: Board) -> None:
    board.machine.run(replug(0x15))
    assert board.machine.run(register(PWM_ALL)).strip() == "0"
    with board.stage("self-test"):
        said = board.machine.run(f"{PROGRAM} selftest")
    states = {line.split(":")[0].split(maxsplit=1)[1]: line.split()[0] for line in said.splitlines()}
    assert set(states.values()) == {"ok"}, said
    assert {"button", "light driver", "indicator", "camera", "light red", "light green", "light blue"} <= set(states)
    assert "twin/IMX296 delivers 182x136" in said
    assert board.machine.run(register(PWM_ALL)).strip() == "255"


def test_a_part_that_is_gone_is_blamed(board: Board) -> None:
    board.machine.run(replug(0x20))
    answer = board.machine.ask(f"{PROGRAM} selftest")
    board.machine.run(replug(0x15))
    assert answer.code == 3
    assert "no chip answers at 0x15 on bus 1" in answer.text


def test_calibration_by_pushing_the_button(board: Board) -> None:
    with board.stage("calibration, 13 pushes"):
        said = board.machine.run(f"{PUSHING} {PROGRAM} calibrate")
    assert re.search(r"Calibration \S+ is active\.", said), said
    with board.stage("start until the instrument is ready"):
        board.start_service()
    assert "Ready: room for" in board.machine.run("journalctl -b -u retroscan -o cat --no-pager")


def test_a_press_becomes_a_scan_bundle(board: Board) -> None:
    """The verdict is doubtful: the object is never lifted, so that the lights are not seen on untouched skin."""
    with board.stage("push to acknowledged scan"):
        scan = board.scan()
    record = board.machine.run(f"cat /data/store/scans/{scan}/scan.json")
    assert '"board": "virtual-board"' in record
    assert '"level": "doubtful"' in record
    assert "the lights could not be checked: lift off" in record


def test_a_workstation_pairs_and_pulls(board: Board, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ports, library = board.machine.ports, tmp_path / "library"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    with board.stage("pair"):
        device = pair_by_button(board.machine, TREE)
    # An emulated sshd on a loaded machine answers later than the 8 s that suffice for a board.
    pull = ("pull", device, "--at", f"127.0.0.1:{ports[SSH]}", "--library", str(library), "--patience-s", "120")
    with board.stage("pull over SFTP"):
        retrosync(*pull)
    pulled = {path.name for path in (library / "scans").iterdir()}
    assert pulled == set(board.acknowledged)
    for path in (library / "scans").iterdir():
        read_scan(path).verify()
    assert {name.removesuffix(".json") for name in board.machine.run("ls /data/store/receipts").split()} >= pulled


def retrosync(*arguments: str) -> str:
    ran = subprocess.run(
        [sys.executable, "-m", "host_sync", *arguments], cwd=TREE, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout
