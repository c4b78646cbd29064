"""Register models of the LED drivers, written from their data sheets, not from the drivers.

They use only the standard library, so that a test in another interpreter can serve them behind a fake `/dev/i2c-1`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable


class RegisterChip:
    """Registers behind an I²C address.

    Parameters
    ----------
    size : number of registers
    power_on : values that are not 0 after power-on
    read_only : registers that ignore writes
    increment : control bit for auto-increment; None when transfers always auto-increment
    last_walked : register after which auto-increment continues at 0, and beyond which it does not move; None for the
        last
    """

    def __init__(
        self,
        size: int,
        power_on: dict[int, int],
        read_only: Iterable[int] = (),
        increment: int | None = 0x80,
        last_walked: int | None = None,
    ) -> None:
        self._size = size
        self._power_on = power_on
        self._read_only = frozenset(read_only)
        self._increment = increment
        self._last_walked = size - 1 if last_walked is None else last_walked
        self.registers = [0] * size
        self.changed: Callable[[], None] = lambda: None
        self.power_cycle()

    def power_cycle(self) -> None:
        """Return to the power-on state."""
        self.registers = [self._power_on.get(register, 0) for register in range(self._size)]
        self.changed()

    def write(self, control: int, data: Iterable[int]) -> None:
        """Receive a write transfer: a control byte and data."""
        register, step = self._start(control)
        for value in data:
            if register not in self._read_only:
                self.written(register, value & 0xFF)
            register = self._next(register, step)
        self.changed()

    def read(self, control: int, count: int) -> list[int]:
        """Return a read transfer of `count` bytes."""
        register, step = self._start(control)
        shown = []
        for _ in range(count):
            shown.append(self.shown(register))
            register = self._next(register, step)
        return shown

    def written(self, register: int, value: int) -> None:
        """Store a value that is written to one register."""
        self.registers[register] = value

    def shown(self, register: int) -> int:
        """Return the value read from one register."""
        return self.registers[register]

    def _next(self, register: int, step: int) -> int:
        if not step or register > self._last_walked:
            return register
        return 0 if register == self._last_walked else register + 1

    def _start(self, control: int) -> tuple[int, int]:
        if self._increment is None:
            return control % self._size, 1
        return (control & ~self._increment) % self._size, int(bool(control & self._increment))


def output_states(packed: list[int]) -> list[int]:
    """Return the state of each of 16 outputs from four LEDOUT registers."""
    return [packed[channel // 4] >> 2 * (channel % 4) & 0b11 for channel in range(16)]


class LedDriverModel(RegisterChip):
    """Common parts of both LED drivers: 16 outputs whose LEDs can be open or shorted, over-temperature, and a pin.

    `enabled` is what the pin that a pull keeps inactive lets through: OE, or the release of RESET.
    """

    def power_cycle(self) -> None:
        """Return to the power-on state; the LEDs stay wired as they were."""
        self.open_channels: set[int] = getattr(self, "open_channels", set())
        self.shorted_channels: set[int] = getattr(self, "shorted_channels", set())
        self.hot = getattr(self, "hot", False)
        self.enabled = getattr(self, "enabled", True)
        super().power_cycle()

    def currents_ma(self) -> list[float]:
        """Return the mean current (mA) through each of the 16 LEDs: 0 where one is missing or shorted."""
        dead = self.open_channels | self.shorted_channels
        dark = self.hot or not self.enabled
        return [0.0 if n in dead or dark else current for n, current in enumerate(self.driven_ma())]

    def enable(self, on: bool) -> None:
        """Move the pin."""
        self.enabled = on
        self.changed()

    def driven_ma(self) -> list[float]:
        """Return the mean current (mA) that each output would carry through an LED."""
        raise NotImplementedError


class Pca9955bModel(LedDriverModel):
    """PCA9955B, which latches errors and increments registers from 00h to 43h by itself.

    After power-on, MODE1 is 89h and the outputs are in PWM mode at duty 0.

    reference_ohm : resistor at REXT; a step of IREF is 900 mV / (4 REXT)
    """

    def __init__(self, reference_ohm: float = 1000.0) -> None:
        self._errors = [0] * 16
        self._step_ma = 225.0 / reference_ohm
        power_on = {0x00: 0x89, 0x01: 0x05} | dict.fromkeys(range(0x02, 0x06), 0xAA)
        super().__init__(0x50, power_on, range(0x46, 0x4A), last_walked=0x43)

    def driven_ma(self) -> list[float]:
        """Return the current of the IREF steps, times the duty, 1 or 0."""
        if self.registers[0x00] & 0x10:
            return [0.0] * 16
        states = output_states(self.registers[0x02:0x06])
        duties = [self.registers[0x08 + n] / 256.0 for n in range(16)]
        group = self.registers[0x06] / 256.0
        factors = [(0.0, 1.0, duty, duty * group)[state] for state, duty in zip(states, duties, strict=True)]
        return [self._step_ma * self.registers[0x18 + n] * factor for n, factor in enumerate(factors)]

    def written(self, register: int, value: int) -> None:
        """PWMALL and IREFALL write all their registers and read 0; MODE2 bit 4 clears the error flags and itself."""
        if register == 0x44:
            self.registers[0x08:0x18] = [value] * 16
        elif register == 0x45:
            self.registers[0x18:0x28] = [value] * 16
        elif register == 0x01:
            if value & 0x10:
                self._errors = [0] * 16
            self.registers[register] = value & 0x2F
        else:
            super().written(register, value)
        self._watch()

    def shown(self, register: int) -> int:
        """MODE2 shows over-temperature and any error; EFLAG0 to 3 show two bits per channel."""
        self._watch()
        if register == 0x01:
            return self.registers[register] | 0x80 * self.hot | 0x40 * any(self._errors)
        if 0x46 <= register <= 0x49:
            four = self._errors[4 * (register - 0x46) :][:4]
            return sum(flag << 2 * n for n, flag in enumerate(four))
        return super().shown(register)

    def _watch(self) -> None:
        for n, current in enumerate(self.driven_ma()):
            if current and n in self.shorted_channels:
                self._errors[n] = 0b01
            elif current and n in self.open_channels:
                self._errors[n] = 0b10


class Tlc59116Model(LedDriverModel):
    """TLC59116: asleep after power-on, one current for all, open circuits read 0 in EFLAG1 and 2.

    reference_ohm : resistor at REXT
    """

    def __init__(self, reference_ohm: float = 1000.0) -> None:
        self._relative_current = 1000.0 / reference_ohm
        power_on = {0x00: 0x11, 0x12: 0xFF, 0x18: 0xD2, 0x19: 0xD4, 0x1A: 0xD8, 0x1B: 0xD0, 0x1C: 0xFF}
        super().__init__(0x1F, power_on, (0x1D, 0x1E))

    def enable(self, on: bool) -> None:
        """Move the RESET pin; in reset the registers are those after power-on."""
        self.enabled = on
        self.power_cycle()

    def driven_ma(self) -> list[float]:
        """Shared current times each channel's duty."""
        iref = self.registers[0x1C]
        voltage_gain = (1 + (iref >> 6 & 1)) * (1.0 + (iref & 0x3F) / 64.0) / 4.0
        full_ma = self._relative_current * 15.0 * 1.26 * voltage_gain * 3.0 ** ((iref >> 7) - 1)
        if self.registers[0x00] & 0x10:
            return [0.0] * 16
        states = output_states(self.registers[0x14:0x18])
        duties = [self.registers[0x02 + n] / 256.0 for n in range(16)]
        group = self.registers[0x12] / 256.0
        return [full_ma * (0.0, 1.0, duty, duty * group)[state] for state, duty in zip(states, duties, strict=True)]

    def shown(self, register: int) -> int:
        """EFLAG1 and 2 (SLDS223A, tables 1 and 2): 1 is normal, and detected only where a channel is fully on.

        MODE2 bit 7 clears the over-temperature flag, which hides it.
        """
        if register not in (0x1D, 0x1E):
            return super().shown(register)
        states = output_states(self.registers[0x14:0x18])
        hot = self.hot and not self.registers[0x01] & 0x80
        first = 8 * (register - 0x1D)
        sound = [states[n] == 0b01 and n not in self.open_channels and not hot for n in range(first, first + 8)]
        return sum(1 << n for n, well in enumerate(sound) if well)
