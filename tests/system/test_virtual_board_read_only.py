"""The board as it is meant to be used, its root read only: what test_virtual_board_mishaps.py switched off, used on.

The overlay is Debian's overlayroot in an initramfs, as on Raspberry Pi OS. QEMU has no firmware that would read
cmdline.txt: the test does, and starts the machine with what install.sh wrote there.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from virtual_board import INSTALL, SHARES, Board

pytestmark = pytest.mark.system

ANOTHER_NUMBER = "00000000-0000-4000-8000-00000000000b"
WORKSHOP = "/etc/netplan/90-NM-11111111-0000-4000-8000-000000000001.yaml"
IDENTITY = "ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub; hostname; cat /data/pairing/authorized_keys"
PROTECTED = "wifi-sec.key-mgmt wpa-psk wifi-sec.psk notasecret"
KNOWN = "nmcli --terse --fields TYPE,NAME connection show | sed -n 's/^802-11-wireless://p' | grep ."
BELOW = "mkdir -p /run/below; mount --bind / /run/below; cp /etc/netplan/* /run/below/etc/netplan/; umount /run/below"
"""As if the network had been there before the first installation: in the root too, below what is mounted over it."""

IMAGE = "/boot/firmware/initramfs8"
ROOTS = "findmnt -n -o FSTYPE /; findmnt -n -o OPTIONS /media/root-ro | cut -d , -f 1; findmnt -n -o FSTYPE /data"


def netplan(name: str, number: int) -> str:
    """A script that writes a network as NetworkManager of Raspberry Pi OS trixie does: YAML in /etc/netplan.

    Debian's own writes key files alone.
    """
    uuid = f"11111111-0000-4000-8000-{number:012d}"
    return f"""
umask 077
cat >/etc/netplan/90-NM-{uuid}.yaml <<END
network:
  version: 2
  wifis:
    NM-{uuid}:
      renderer: NetworkManager
      match: {{}}
      dhcp4: true
      access-points:
        "{name}":
          auth: {{key-management: psk, password: "not a secret"}}
          networkmanager: {{uuid: "{uuid}", name: "{name}"}}
      networkmanager: {{uuid: "{uuid}", name: "{name}"}}
END
"""


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a copy of the root's disk is kept, as it was when it became read only."""
    return tmp_path_factory.mktemp("before") / "root.qcow2"


def test_install_makes_the_root_read_only(board: Board, before: Path) -> None:
    if not board.machine.is_on:
        board.machine.switch_on()
        board.machine.wait_for("systemctl is-active retroscan")
    board.machine.run(SHARES + netplan("workshop", 1) + BELOW)
    board.machine.run("systemctl --quiet enable NetworkManager")
    board.machine.run(f"echo . | cpio --quiet -o -H newc >{IMAGE}")
    refused = board.machine.ask(f"{INSTALL} --read-only")
    assert (refused.code, f"{IMAGE} lacks the script overlayroot" in refused.text) == (1, True), refused.text
    assert "overlayroot" not in board.machine.run("cat /boot/firmware/cmdline.txt")
    shutil.copy(board.machine.cache / "initrd.img", board.handover / "initrd.img")
    board.machine.run(f"cp /mnt/handover/initrd.img {IMAGE}")
    with board.stage("install.sh --read-only"):
        said = board.machine.run(f"{INSTALL} --read-only")
    assert "write /boot/firmware/cmdline.txt" in said
    command_line = board.machine.run("cat /boot/firmware/cmdline.txt").strip()
    assert command_line.endswith(" overlayroot=tmpfs:recurse=0")
    board.machine.power_off()
    shutil.copy(board.machine.disk, before)
    with board.stage("read-only boot until the instrument is ready"):
        board.machine.switch_on(command_line)
        board.machine.wait_for("systemctl is-active retroscan")
    assert board.machine.run(ROOTS).split() == ["overlay", "ro", "ext4"]
    refused = board.machine.ask(SHARES + INSTALL)
    assert (refused.code, "the root file system is read only: run this with --writable" in refused.text) == (2, True)


def test_scans_networks_and_updates_outlive_a_boot_and_nothing_else_does(board: Board) -> None:
    machine = board.machine
    identity, told = machine.run(IDENTITY), machine.run("ls /data/store/scans").split()
    assert set(told) >= set(board.acknowledged)
    assert machine.wait_for(KNOWN).split() == ["workshop"]
    machine.run(f"rm {WORKSHOP}; touch /var/scribble; {netplan('lab', 2)}")
    machine.run(f"nmcli connection add type wifi ifname '*' con-name bench ssid bench {PROTECTED}")
    machine.run("echo '- [damaged' >/etc/netplan/99-damaged.yaml; : >/etc/netplan/90-NM-empty.yaml")
    scan = board.scan()
    with board.stage("update on a read-only root"):
        assert "is in slot b" in machine.run("retrograph-slot install /mnt/handover/release")
    with board.stage("read-only reboot until the instrument is ready"):
        machine.reboot()
        machine.wait_for("systemctl is-active retroscan")
    assert machine.run(ROOTS).split() == ["overlay", "ro", "ext4"]
    machine.run("test ! -e /var/scribble")
    assert machine.run(IDENTITY) == identity
    assert set(machine.run("ls /data/store/scans").split()) == {*told, scan}
    assert sorted(machine.wait_for(KNOWN).split()) == ["bench", "lab"]
    assert "slot b: 0.1.0, in use" in machine.run("retrograph-slot status")
    machine.run("retrograph-slot rollback")
    assert "slot a: 0.1.0, in use" in machine.run("retrograph-slot status")
    machine.wait_for("systemctl is-active retroscan")
    board.scan()


def test_the_root_is_as_it_was_to_the_last_block(board: Board, before: Path) -> None:
    board.machine.power_off()
    subprocess.run(["qemu-img", "compare", "-q", before, board.machine.disk], check=True)


def test_a_card_in_another_board_is_another_device(board: Board) -> None:
    board.machine.number = ANOTHER_NUMBER
    command_line = "console=ttyS0 root=/dev/vda rootfstype=ext4 quiet overlayroot=tmpfs:recurse=0"
    machine, told = board.machine, "journalctl -b -u retrograph-first-boot -o cat --no-pager"
    with board.stage("boot of a copied card until the instrument is ready"):
        machine.switch_on(command_line)
        machine.wait_for("systemctl is-active retroscan")
    said = machine.run(told)
    assert "this card was set up in another board (number 00000000-0000-4000-8000-00000000000a)" in said
    assert "made the host key SHA256:" in said
    assert "this device is rg" in said
    machine.run("test ! -e /data/pairing/authorized_keys; test -s /data/pairing/authorized_keys.of-another-board")
    assert set(machine.run("ls /data/store/scans").split()) >= set(board.acknowledged)
    assert "no calibration is active" in machine.run("systemctl show -P StatusText retroscan")


def test_a_root_that_stayed_writable_is_an_alarm(board: Board) -> None:
    """As with an initramfs that lacks the driver: overlayroot goes on without it."""
    board.machine.power_off()
    board.machine.switch_on("console=ttyS0 root=/dev/vda rw rootfstype=ext4 quiet overlayroot=tmpfs:driver=absent")
    board.machine.wait_for("systemctl is-active retroscan")
    assert board.machine.run("findmnt -n -o FSTYPE /").strip() == "ext4"
    for place in ("systemctl show -P StatusText retroscan", "journalctl -b -u retroscan -o cat --no-pager"):
        board.machine.wait_for(
            f"{place} | grep 'the root file system is writable although it is meant to be read-only'"
        )


def test_without_the_data_partition_ssh_answers_with_a_key_of_that_boot(board: Board) -> None:
    """For whoever repairs the card; the device's own key is on what is missing."""
    machine = board.machine
    machine.power_off()
    machine.data = None
    with board.stage("boot without the data partition until SSH answers"):
        machine.switch_on("console=ttyS0 root=/dev/vda rootfstype=ext4 quiet overlayroot=tmpfs:recurse=0")
        machine.wait_for("ssh-keyscan -t ed25519 localhost 2>/dev/null | grep ssh-ed25519")
    machine.run("systemctl is-active retrograph-rescue-key")
    assert machine.ask("mountpoint -q /data").code != 0
    assert machine.ask("systemctl is-active retroscan").code != 0
    shown = machine.run("ssh-keyscan -t ed25519 localhost 2>/dev/null | sed -n 's/.* ssh-ed25519 //p'")
    assert shown == machine.run("cut -d ' ' -f 2 /run/retrograph-rescue/ssh_host_ed25519_key.pub")
