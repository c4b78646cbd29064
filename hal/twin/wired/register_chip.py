"""A chip of registers behind an I²C address: auto-increment, read-only registers, and nothing but the standard library.

The models stand alone so that a test bed in another interpreter can serve them behind a fake `/dev/i2c-1`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable


class RegisterChip:
    """Registers with a power-on state.

    Parameters
    ----------
    size : number of registers
    power_on : values that are not 0 after power-on
    read_only : registers that ignore what is written
    increment : the bit of the control byte that makes transfers walk; None when they always walk
    """

    def __init__(
        self,
        size: int,
        power_on: dict[int, int],
        read_only: Iterable[int] = (),
        increment: int | None = 0x80,
    ) -> None:
        self._size = size
        self._power_on = power_on
        self._read_only = frozenset(read_only)
        self._increment = increment
        self.registers = [0] * size
        self.changed: Callable[[], None] = lambda: None
        self.power_cycle()

    def power_cycle(self) -> None:
        """The state after power-on."""
        self.registers = [self._power_on.get(register, 0) for register in range(self._size)]
        self.changed()

    def write(self, control: int, data: Iterable[int]) -> None:
        """A write transfer: a control byte and data."""
        register, step = self._start(control)
        for value in data:
            if register not in self._read_only:
                self.written(register, value & 0xFF)
            register = (register + step) % self._size
        self.changed()

    def read(self, control: int, count: int) -> list[int]:
        """A read transfer of `count` bytes."""
        register, step = self._start(control)
        return [self.shown((register + step * offset) % self._size) for offset in range(count)]

    def written(self, register: int, value: int) -> None:
        """What a write does to one register."""
        self.registers[register] = value

    def shown(self, register: int) -> int:
        """What a read shows of one register."""
        return self.registers[register]

    def _start(self, control: int) -> tuple[int, int]:
        if self._increment is None:
            return control % self._size, 1
        return (control & ~self._increment) % self._size, int(bool(control & self._increment))


def output_states(packed: list[int]) -> list[int]:
    """State of each of 16 outputs from four LEDOUT registers."""
    return [packed[channel // 4] >> 2 * (channel % 4) & 0b11 for channel in range(16)]
