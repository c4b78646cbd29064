"""What may happen to a handheld in use, on the virtual board that test_virtual_board.py made.

Hung, killed, unplugged, its power cut; updated with broken versions; started anew; at last switched off.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from broken_release import INSTRUMENT, SELF_TEST, release_with
from crash_disk import Recording, lost_scans, read_log
from virtual_board import INSTALL, LEDOUT0, ONE_NETWORK, SHARES, STATUS, Board, register, replug

from device.bundles.scan import ScanBundle

pytestmark = pytest.mark.system

CUTS = 60
DROP_INS = "/run/systemd/system/retroscan.service.d"


def test_a_hung_work_loop_is_started_again(board: Board) -> None:
    board.machine.run(
        f"mkdir -p {DROP_INS}; printf '[Service]\\nWatchdogSec=12\\n' >{DROP_INS}/hurry.conf; systemctl daemon-reload"
    )
    board.start_service()
    hung = board.machine.run("systemctl show -P MainPID retroscan").strip()
    with board.stage("hang to ready again"):
        board.machine.run(f"kill -STOP {hung}")
        board.machine.wait_for("test $(systemctl show -P NRestarts retroscan) = 1")
        board.machine.wait_for("systemctl is-active retroscan")
    assert board.machine.run("systemctl show -P MainPID retroscan").strip() != hung
    journal = board.machine.run("journalctl -b -u retroscan -o cat --no-pager")
    assert "Watchdog timeout" in journal
    board.scan()
    board.machine.run(f"rm {DROP_INS}/hurry.conf; systemctl daemon-reload")
    board.start_service()


def test_acknowledged_scans_survive_power_cuts(
    board: Board, tmp_path: Path, publish_scan: Callable[..., ScanBundle]
) -> None:
    with board.stage("six scans while every write is recorded"):
        for _ in range(6):
            board.scan()
    writes = read_log(board.machine.log)
    recording = Recording(board.blank, board.machine.log, writes, dict(board.acknowledged))
    with board.stage(f"{CUTS} power cuts replayed"):
        assert lost_scans(recording, CUTS, tmp_path, publish_scan) == []
    assert len(recording.acknowledged) == 8


def test_lights_are_dark_however_the_program_ends(board: Board) -> None:
    outputs = register(LEDOUT0, 4)
    board.start_service()
    board.machine.wait_for(f"{outputs} | grep '[1-9]'", 120.0)
    with board.stage("SIGKILL to dark"):
        board.machine.run(
            f"mkdir -p {DROP_INS}; printf '[Service]\\nRestart=no\\n' >{DROP_INS}/once.conf; systemctl daemon-reload; "
            "systemctl kill --signal KILL --kill-whom main retroscan"
        )
        board.machine.wait_for("systemctl is-failed retroscan")
    assert board.machine.run(outputs).split() == ["0"] * 4
    board.machine.run(f"rm {DROP_INS}/once.conf; systemctl daemon-reload")
    board.start_service()


def test_a_part_that_goes_and_comes_back_is_reported_in_the_status(board: Board) -> None:
    """The instrument becomes ready all the same, for its screen and its scans; an update that starts so is undone."""
    board.machine.run("systemctl stop retroscan; " + replug(0x20))
    with board.stage("start without a light driver"):
        board.start_service()
    assert board.machine.run(STATUS).startswith("out of order: no chip answers at 0x15 on bus 1")
    with board.stage("update that starts out of order"):
        answer = board.machine.ask("retrograph-slot install /mnt/handover/release --skip-selftest")
    assert (answer.code, "back to version 0.1.0 in slot a" in answer.text) == (1, True), answer.text
    board.machine.run(replug(0x15))
    board.machine.wait_for(f"{STATUS} | grep '^ready: room for'")
    board.scan()


def test_a_version_that_fails_its_self_test_is_refused(board: Board, release: Path) -> None:
    release_with(release, board.handover / "dark", "9.9.1", SELF_TEST, "    return 3\n")
    with board.stage("update that fails its self-test"):
        answer = board.machine.ask("retrograph-slot install /mnt/handover/dark")
    assert (answer.code, "9.9.1 fails its self-test: version 0.1.0 stays" in answer.text) == (1, True), answer.text
    board.machine.run("systemctl is-active retroscan")
    board.scan()


def test_a_version_that_never_becomes_ready_is_undone(board: Board, release: Path) -> None:
    release_with(release, board.handover / "silent", "9.9.2", INSTRUMENT, "    return 3\n")
    with board.stage("update that never becomes ready"):
        answer = board.machine.ask("retrograph-slot install /mnt/handover/silent --skip-selftest")
    assert answer.code == 1, answer.text
    assert "back to version 0.1.0" in answer.text + board.machine.run("journalctl -b -o cat --no-pager")
    board.machine.wait_for("systemctl is-active retroscan")
    assert board.machine.run("retroscan --version").split() == ["retrograph", "0.1.0"]
    board.scan()


def test_everything_comes_up_by_itself_after_a_reboot(board: Board) -> None:
    """As if the power had gone in the middle of an update: it proves itself at boot, before the instrument starts."""
    board.machine.run("echo b 0 >/data/app/trial; sync")
    with board.stage("reboot, self-test, until the instrument is ready again"):
        board.machine.reboot()
        board.machine.wait_for("systemctl is-active retroscan")
    assert "it stays" in board.machine.run("test ! -e /data/app/trial; journalctl -b -o cat --no-pager")
    assert "ok       light driver" in board.machine.run("journalctl -b -u retrograph-trial -o cat --no-pager")
    announced = board.machine.run("journalctl -b -u avahi-daemon -o cat --no-pager")
    assert re.search(r"Loading service file \S*/retrograph\.service", announced), announced
    state = board.machine.run("systemctl is-system-running --wait || true").strip()
    failed = board.machine.run("systemctl --failed --plain --no-legend; systemctl show retroscan -P NRestarts")
    assert (state, failed.strip()) == ("running", "0")
    board.scan()


def test_the_usb_cable_is_a_network(board: Board) -> None:
    """The controller's cable ends on the same machine: both of its ends are seen."""
    board.machine.run(SHARES + ONE_NETWORK)
    assert "enable retrograph-usb.service" in board.machine.run(f"{INSTALL} --usb")
    with board.stage("USB adapter"):
        board.machine.run("systemctl start retrograph-usb")
        addresses = board.machine.wait_for(
            "cat /sys/class/net/*/address | grep -E '^0[26]:' | sort | tee /run/both; test $(wc -l </run/both) = 2"
        ).split()
    assert [address[:2] for address in addresses] == ["02", "06"]
    assert addresses[0][2:] == addresses[1][2:]
    board.machine.run("systemctl stop retrograph-usb; test ! -e /sys/kernel/config/usb_gadget/retrograph")


def test_power_off_in_order_leaves_everything(
    board: Board, tmp_path: Path, publish_scan: Callable[..., ScanBundle]
) -> None:
    with board.stage("power off in order, by the button"):
        board.machine.power_off("systemctl is-active retroscan; /usr/local/lib/virtual/press 12")
    writes = read_log(board.machine.log)
    recording = Recording(board.blank, board.machine.log, writes, dict(board.acknowledged))
    assert lost_scans(recording, 1, tmp_path, publish_scan) == []
