"""The virtual board as a handheld: helpers that push, ask and wait in the system tests."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

from crash_disk import logged_entries
from virtual_machine import VirtualMachine

Stage = Callable[[str], AbstractContextManager[None]]
DATA_MIB = 384
SHARES = """
mount -t 9p -o trans=virtio,version=9p2000.L,ro source /mnt/source
mount -t 9p -o trans=virtio,version=9p2000.L,ro handover /mnt/handover
"""
ONE_NETWORK = """
mkdir -p /etc/systemd/network/emulated.network.d
printf '[Match]\\nDriver=virtio_net\\n' >/etc/systemd/network/emulated.network.d/one.conf
networkctl reload
"""
PATIENCE = """
for unit in retroscan retrograph-first-boot retrograph-trial; do
    mkdir -p /etc/systemd/system/$unit.service.d
    printf '[Service]\\nTimeoutStartSec=600\\nTimeoutStopSec=300\\n' >/etc/systemd/system/$unit.service.d/patience.conf
done
"""
"""An emulated processor takes half a minute to start Python, more than the units allow a board."""

INSTALL = "/mnt/handover/release/board/install.sh --board /mnt/source/tests/system/virtual-board.toml"
PROGRAM = "runuser -u retroscan -- retroscan --board /etc/retrograph/board.toml --store /var/lib/retroscan"
STATUS = "systemctl show -P StatusText retroscan"
PUSHING = "(while :; do sleep 2; /usr/local/lib/virtual/press; done) & pushing=$!; trap 'kill $pushing' EXIT; "
PWM_ALL, LEDOUT0 = 0x44, 0x82
"""Address in the stub, which treats the auto-increment bit as part of the register number."""

SCAN_SAID = re.compile(r"^\w+: .* \(([\w-]+)\)$", re.MULTILINE)


def register(number: int, count: int = 1) -> str:
    """A script that prints this many registers of the stub."""
    read = f"from smbus2 import SMBus; print(*SMBus(1).read_i2c_block_data(0x15, {number}, {count}))"
    return f"/data/app/current/bin/python -c '{read}' 2>/dev/null"


def replug(address: int) -> str:
    """A script that reconnects the stub at an address, with empty registers, between two attempts of an instrument."""
    gone = "until rmmod i2c-stub 2>/dev/null; do sleep 0.2; done"
    return f"{gone}; modprobe i2c-stub chip_addr={address:#x}; udevadm settle"


@dataclass
class Board:
    """The machine, and the progress of its tests.

    acknowledged : number of writes to the data disk after which each scan was reported to its user
    """

    machine: VirtualMachine
    stage: Stage
    blank: Path
    handover: Path
    acknowledged: dict[str, int] = field(default_factory=dict)

    def start_service(self) -> None:
        """Start the instrument and wait until it reports ready."""
        self.machine.run("systemctl reset-failed retroscan; systemctl restart retroscan")

    def scan(self) -> str:
        """Push the button; returns the id of the scan that the instrument then reports."""
        before = len(self._reported())
        self.machine.run("/usr/local/lib/virtual/press")
        end = time.monotonic() + 120.0
        while len(reported := self._reported()) == before:
            assert time.monotonic() < end, self.machine.run("journalctl -u retroscan -n 30 -o cat --no-pager")
            time.sleep(0.5)
        assert len(reported) == before + 1
        self.acknowledged[reported[-1]] = logged_entries(self.machine.log)
        return reported[-1]

    def _reported(self) -> list[str]:
        return SCAN_SAID.findall(self.machine.run("journalctl -u retroscan -o cat --no-pager"))
