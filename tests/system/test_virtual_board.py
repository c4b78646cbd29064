"""The whole handheld on a virtual board: installed, scanned with, pulled from, hung, updated, switched off.

One machine; its tests build on one another in this order, as somebody would use it. What it shows and what it cannot is
in docs/system-tests.md.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from broken_release import release_with
from crash_disk import Recording, logged_entries, lost_scans, read_log
from virtual_machine import PAIRING, SSH, VirtualMachine

from device.scan_bundle import ScanBundle, read_scan

pytestmark = pytest.mark.system

Stage = Callable[[str], AbstractContextManager[None]]
TREE = Path(__file__).parents[2]
DATA_MIB = 384
SHARES = """
mount -t 9p -o trans=virtio,version=9p2000.L,ro source /mnt/source
mount -t 9p -o trans=virtio,version=9p2000.L,ro handover /mnt/handover
"""
PATIENCE = """
for unit in retroscan retrograph-first-boot retrograph-trial; do
    mkdir -p /etc/systemd/system/$unit.service.d
    printf '[Service]\\nTimeoutStartSec=600\\nTimeoutStopSec=300\\n' >/etc/systemd/system/$unit.service.d/patience.conf
done
"""
"""An emulated processor starts Python for half a minute: what the units allow a board is not enough for it."""

PROGRAM = "runuser -u retroscan -- retroscan --board /etc/retrograph/board.toml --store /var/lib/retroscan"
PUSHING = "(while :; do sleep 2; /usr/local/lib/virtual/press; done) & pushing=$!; trap 'kill $pushing' EXIT; "
REGISTER = (
    "/data/app/current/bin/python -c 'from smbus2 import SMBus; print(SMBus(1).read_byte_data(0x15, {}))' 2>/dev/null"
)
PWM_ALL = 0x44
SCAN_SAID = re.compile(r"^\w+: .* \(([\w-]+)\)$", re.MULTILINE)
CUTS = 60


@dataclass
class Board:
    """The machine, and what became of its tests so far.

    acknowledged : after how many writes of the data disk each scan was told to its user
    """

    machine: VirtualMachine
    stage: Stage
    blank: Path
    handover: Path
    acknowledged: dict[str, int] = field(default_factory=dict)

    def start_service(self) -> None:
        """The instrument, until it says that it is ready."""
        self.machine.run("systemctl reset-failed retroscan; systemctl restart retroscan")

    def scan(self) -> str:
        """Pushes the button; the id of the scan that the instrument then told of."""
        before = len(self._told())
        self.machine.run("/usr/local/lib/virtual/press")
        end = time.monotonic() + 120.0
        while len(told := self._told()) == before:
            assert time.monotonic() < end, self.machine.run("journalctl -u retroscan -n 30 -o cat --no-pager")
            time.sleep(0.5)
        assert len(told) == before + 1
        self.acknowledged[told[-1]] = logged_entries(self.machine.log)
        return told[-1]

    def _told(self) -> list[str]:
        return SCAN_SAID.findall(self.machine.run("journalctl -u retroscan -o cat --no-pager"))


@pytest.fixture(scope="module")
def release(system_cache: Path, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release folder with the wheels that a device without a network needs; the heavy ones are in its root."""
    folder = tmp_path_factory.mktemp("handover") / "release"
    folder.mkdir()
    shutil.copy(wheel, folder)
    shutil.copy(TREE / "requirements-device.lock", folder)
    for part in ("board", "systemd"):
        shutil.copytree(TREE / part, folder / part)
    (folder / "wheels").mkdir()
    for needed in (system_cache / "wheels" / "device").iterdir():
        if not needed.name.startswith(("numpy", "scipy", "opencv", "imagecodecs")):
            shutil.copy(needed, folder / "wheels")
    return folder


@pytest.fixture(scope="module")
def board(system_cache: Path, release: Path, tmp_path_factory: pytest.TempPathFactory, stage: Stage) -> Iterator[Board]:
    folder = tmp_path_factory.mktemp("vm")
    data, blank = folder / "data.img", folder / "blank.img"
    with data.open("wb") as stream:
        stream.truncate(DATA_MIB << 20)
    subprocess.run(["mkfs.ext4", "-q", "-L", "retrograph-data", "-m", "0", data], check=True)
    subprocess.run(["cp", "--sparse=always", data, blank], check=True)
    shares = {"source": TREE, "handover": release.parent}
    with ExitStack() as held:
        with stage("first boot"):
            machine = held.enter_context(VirtualMachine(system_cache, folder, shares, data=data))
            machine.run("systemctl is-system-running --wait || true")
            machine.run(SHARES)
        yield Board(machine, stage, blank, release.parent)


def test_install_makes_a_handheld_and_is_idempotent(board: Board) -> None:
    install = "/mnt/handover/release/board/install.sh --board /mnt/source/tests/system/virtual-board.toml"
    with board.stage("install.sh"):
        assert "Done." in board.machine.run(install)
    assert board.machine.run(install).splitlines()[-1] == "Everything is in place."
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
    board.machine.run("systemctl stop retroscan")


def test_the_self_test_drives_bus_and_lines(board: Board) -> None:
    board.machine.run("rmmod i2c-stub; modprobe i2c-stub chip_addr=0x15; udevadm settle")
    assert board.machine.run(REGISTER.format(PWM_ALL)).strip() == "0"
    with board.stage("self-test"):
        said = board.machine.run(f"{PROGRAM} selftest")
    states = {line.split(":")[0].split(maxsplit=1)[1]: line.split()[0] for line in said.splitlines()}
    assert set(states.values()) == {"ok"}, said
    assert {"button", "light driver", "indicator", "camera", "light red", "light green", "light blue"} <= set(states)
    assert "twin/IMX296 delivers 182x136" in said
    assert board.machine.run(REGISTER.format(PWM_ALL)).strip() == "255"


def test_a_part_that_is_gone_is_blamed(board: Board) -> None:
    board.machine.run("rmmod i2c-stub; modprobe i2c-stub chip_addr=0x20; udevadm settle")
    answer = board.machine.ask(f"{PROGRAM} selftest")
    board.machine.run("rmmod i2c-stub; modprobe i2c-stub chip_addr=0x15; udevadm settle")
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
    with board.stage("push to acknowledged scan"):
        scan = board.scan()
    record = board.machine.run(f"cat /data/store/scans/{scan}/scan.json")
    assert '"board": "virtual-board"' in record
    assert '"level": "good"' in record


def test_a_workstation_pairs_and_pulls(board: Board, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ports, library = board.machine.ports, tmp_path / "library"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    opened = board.machine.run(
        "systemctl stop retrograph-pairing; date +%s; systemctl start retrograph-pairing"
    ).strip()
    shown = (
        f"journalctl -u retrograph-pairing --since @{opened} -o cat --no-pager | grep -oE 'Code [0-9]{{4}} [0-9]{{4}}'"
    )
    code = board.machine.wait_for(shown).strip().removeprefix("Code ").replace(" ", "")
    with board.stage("pair"):
        paired = retrosync("pair", "127.0.0.1", "--port", str(ports[PAIRING]), "--code", code)
    device = re.search(r"Paired with (\S+) at", paired)
    assert device, paired
    pull = ("pull", device[1], "--at", f"127.0.0.1:{ports[SSH]}", "--library", str(library))
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


def test_a_hung_work_loop_is_started_again(board: Board) -> None:
    drop_in = "/run/systemd/system/retroscan.service.d/hurry.conf"
    board.machine.run(
        f"mkdir -p {Path(drop_in).parent}; printf '[Service]\\nWatchdogSec=12\\n' >{drop_in}; systemctl daemon-reload"
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
    board.machine.run(f"rm {drop_in}; systemctl daemon-reload")
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


def test_a_version_that_fails_its_self_test_is_refused(board: Board, release: Path) -> None:
    release_with(release, board.handover / "dark", "9.9.1", "def _selftest(", "    return 3\n")
    with board.stage("update that fails its self-test"):
        answer = board.machine.ask("retrograph-slot install /mnt/handover/dark")
    assert (answer.code, "9.9.1 fails its self-test: version 0.1.0 stays" in answer.text) == (1, True), answer.text
    board.machine.run("systemctl is-active retroscan")
    board.scan()


def test_a_version_that_never_becomes_ready_is_undone(board: Board, release: Path) -> None:
    release_with(release, board.handover / "silent", "9.9.2", "def _watch(", "    return 3\n")
    with board.stage("update that never becomes ready"):
        answer = board.machine.ask("retrograph-slot install /mnt/handover/silent --skip-selftest")
    assert answer.code == 1, answer.text
    assert "back to version 0.1.0" in answer.text + board.machine.run("journalctl -b -o cat --no-pager")
    board.machine.wait_for("systemctl is-active retroscan")
    assert board.machine.run("retroscan --version").split() == ["retrograph", "0.1.0"]
    board.scan()


def test_everything_comes_up_by_itself_after_a_reboot(board: Board) -> None:
    with board.stage("reboot until the instrument is ready again"):
        board.machine.reboot()
        board.machine.wait_for("systemctl is-active retroscan")
    state = board.machine.run("systemctl is-system-running --wait || true").strip()
    failed = board.machine.run("systemctl --failed --plain --no-legend; systemctl show retroscan -P NRestarts")
    assert (state, failed.strip()) == ("running", "0")
    board.scan()


def test_power_off_in_order_leaves_everything(
    board: Board, tmp_path: Path, publish_scan: Callable[..., ScanBundle]
) -> None:
    with board.stage("power off in order"):
        board.machine.power_off()
    writes = read_log(board.machine.log)
    recording = Recording(board.blank, board.machine.log, writes, dict(board.acknowledged))
    assert lost_scans(recording, 1, tmp_path, publish_scan) == []
