"""An emulated `SMBus` of smbus2 with chips on it, and the faults of a bus."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from hal.interfaces import Clock
from hal.simulator.led_chips import RegisterChip

MAX_BYTES = 32
STUCK_S = 1.0
"""Time-out of the kernel's driver on a stuck bus."""


@dataclass(slots=True)
class WireFaults:
    """Fault switches of one bus, set at any time.

    refused : number of transfers that fail with "remote I/O error" from now on
    unplugged : addresses where no chip answers
    stuck : a line is held low
    gone : the bus itself has disappeared
    """

    refused: int = 0
    unplugged: set[int] = field(default_factory=set)
    stuck: bool = False
    gone: bool = False


class FakeI2cBus:
    """A bus; `open` returns handles like smbus2's."""

    def __init__(self, chips: Mapping[int, RegisterChip], clock: Clock) -> None:
        self.chips = dict(chips)
        self.faults = WireFaults()
        self.clock = clock
        self.opened = 0

    def open(self, bus: int) -> WireHandle:
        """A handle on bus 1, the only one."""
        if self.faults.gone or bus != 1:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), f"/dev/i2c-{bus}")
        self.opened += 1
        return WireHandle(self)

    def reach(self, address: int) -> RegisterChip:
        """The chip at an address, if it can be reached."""
        if self.faults.gone:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        if self.faults.stuck:
            self.clock.sleep(STUCK_S)
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
        if self.faults.refused:
            self.faults.refused -= 1
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        if address not in self.chips or address in self.faults.unplugged:
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        return self.chips[address]


class WireHandle:
    """See smbus2's `SMBus`."""

    def __init__(self, wire: FakeI2cBus) -> None:
        self._wire: FakeI2cBus | None = wire

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        """Read `length` bytes, at most 32."""
        return self._reach(i2c_addr, length).read(register, length)

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int]) -> None:
        """Write up to 32 bytes."""
        self._reach(i2c_addr, len(data)).write(register, data)

    def close(self) -> None:
        """Release the handle."""
        if self._wire is not None:
            self._wire.opened -= 1
            self._wire = None

    def _reach(self, address: int, length: int) -> RegisterChip:
        if self._wire is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        if length > MAX_BYTES:
            raise ValueError(f"Desired block length over {MAX_BYTES} bytes")
        return self._wire.reach(address)
