"""A likeness of smbus2's `SMBus` with chips on it, and everything that can go wrong with a wire."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from hal.interfaces import Clock
from hal.twin.wired.register_chip import RegisterChip

MOST_BYTES = 32
STUCK_S = 1.0
"""How long the kernel's driver waits for a bus that is held."""


@dataclass(slots=True)
class WireFaults:
    """Switches of one bus, thrown at any time.

    refused : transfers that the next ones fail with "remote I/O error", then all is well again
    unplugged : addresses where no chip answers
    stuck : a line is held low
    gone : the bus itself has vanished
    """

    refused: int = 0
    unplugged: set[int] = field(default_factory=set)
    stuck: bool = False
    gone: bool = False


class I2cWire:
    """A bus; `open` hands out handles like smbus2's."""

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
        """The chip at an address, if the wire lets it be reached."""
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

    def __init__(self, wire: I2cWire) -> None:
        self._wire: I2cWire | None = wire

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        """`length` bytes, 32 at most."""
        return self._reach(i2c_addr, length).read(register, length)

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int]) -> None:
        """Up to 32 bytes."""
        self._reach(i2c_addr, len(data)).write(register, data)

    def close(self) -> None:
        """Give the handle back."""
        if self._wire is not None:
            self._wire.opened -= 1
            self._wire = None

    def _reach(self, address: int, length: int) -> RegisterChip:
        if self._wire is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        if length > MOST_BYTES:
            raise ValueError(f"Desired block length over {MOST_BYTES} bytes")
        return self._wire.reach(address)
