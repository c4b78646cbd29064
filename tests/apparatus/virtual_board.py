"""The virtual board as a handheld: what the system tests push, ask and wait for."""

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
mkdir -p /etc/systemd/network/wired.network.d
printf '[Match]\\nDriver=virtio_net\\n' >/etc/systemd/network/wired.network.d/one.conf
networkctl reload
"""
PATIENCE = """
for unit in retroscan retrograph-first-boot retrograph-trial; do
    mkdir -p /etc/systemd/system/$unit.service.d
    printf '[Service]\\nTimeoutStartSec=600\\nTimeoutStopSec=300\\n' >/etc/systemd/system/$unit.service.d/patience.conf
done
"""
"""An emulated processor starts Python for half a minute: what the units allow a board is not enough for it."""

INSTALL = "/mnt/handover/release/board/install.sh --board /mnt/source/tests/system/virtual-board.toml"
PROGRAM = "runuser -u retroscan -- retroscan --board /etc/retrograph/board.toml --store /var/lib/retroscan"
STATUS = "systemctl show -P StatusText retroscan"
PUSHING = "(while :; do sleep 2; /usr/local/lib/virtual/press; done) & pushing=$!; trap 'kill $pushing' EXIT; "
PWM_ALL, LEDOUT0 = 0x44, 0x82
"""Where the stub has them: to it the bit that asks a chip to count on is part of the number."""

SCAN_SAID = re.compile(r"^\w+: .* \(([\w-]+)\)$", re.MULTILINE)


def register(number: int, count: int = 1) -> str:
    """A script that says what stands in so many of the stub's registers."""
    read = f"from smbus2 import SMBus; print(*SMBus(1).read_i2c_block_data(0x15, {number}, {count}))"
    return f"/data/app/current/bin/python -c '{read}' 2>/dev/null"


def replug(address: int) -> str:
    """A script that puts the stub at an address, with nothing in its registers, between two tries of an instrument."""
    gone = "until rmmod i2c-stub 2>/dev/null; do sleep 0.2; done"
    return f"{gone}; modprobe i2c-stub chip_addr={address:#x}; udevadm settle"


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
