"""The LED drivers and the fuel gauge as register models, written from their data sheets, not from the drivers."""

from __future__ import annotations

from hal.twin.wired.register_chip import RegisterChip, output_states


class LedDriverModel(RegisterChip):
    """What both LED drivers have: 16 outputs whose LEDs can be open or shorted, and an over-temperature."""

    def power_cycle(self) -> None:
        """The state after power-on; the LEDs are wired as they were."""
        self.open_channels: set[int] = getattr(self, "open_channels", set())
        self.shorted_channels: set[int] = getattr(self, "shorted_channels", set())
        self.hot = getattr(self, "hot", False)
        super().power_cycle()

    def currents_ma(self) -> list[float]:
        """Mean current (mA) through each of the 16 LEDs: none flows where one is missing, or bridged by a short."""
        dead = self.open_channels | self.shorted_channels
        return [0.0 if n in dead or self.hot else current for n, current in enumerate(self.driven_ma())]

    def driven_ma(self) -> list[float]:
        """Mean current (mA) that each output would carry if an LED were there."""
        raise NotImplementedError


class Pca9955bModel(LedDriverModel):
    """PCA9955B with 1 kΩ at REXT: MODE1 89h after power-on, outputs in PWM mode at duty 0, errors latched."""

    def __init__(self) -> None:
        self._errors = [0] * 16
        super().__init__(0x50, {0x00: 0x89, 0x01: 0x05} | dict.fromkeys(range(0x02, 0x06), 0xAA), range(0x46, 0x4A))

    def driven_ma(self) -> list[float]:
        """By 225 µA a step of IREF and the duty, fully on, or nothing."""
        if self.registers[0x00] & 0x10:
            return [0.0] * 16
        states = output_states(self.registers[0x02:0x06])
        duties = [self.registers[0x08 + n] / 256.0 for n in range(16)]
        group = self.registers[0x06] / 256.0
        shares = [(0.0, 1.0, duty, duty * group)[state] for state, duty in zip(states, duties, strict=True)]
        return [0.225 * self.registers[0x18 + n] * share for n, share in enumerate(shares)]

    def written(self, register: int, value: int) -> None:
        """PWMALL and IREFALL write all of theirs and read 0; MODE2 bit 4 clears the error flags and itself."""
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
        """MODE2 shows over-temperature and any error; EFLAG0 to 3 show two bits a channel."""
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
    """TLC59116 with 1 kΩ at REXT: asleep after power-on, one current for all, open circuits as 0 in EFLAG1 and 2."""

    def __init__(self) -> None:
        power_on = {0x00: 0x11, 0x12: 0xFF, 0x18: 0xD2, 0x19: 0xD4, 0x1A: 0xD8, 0x1B: 0xD0, 0x1C: 0xFF}
        super().__init__(0x1F, power_on, (0x1D, 0x1E))

    def driven_ma(self) -> list[float]:
        """By the shared current's gain and each channel's duty."""
        iref = self.registers[0x1C]
        voltage_gain = (1 + (iref >> 6 & 1)) * (1.0 + (iref & 0x3F) / 64.0) / 4.0
        full_ma = 15.0 * 1.26 * voltage_gain * 3.0 ** ((iref >> 7) - 1)
        if self.registers[0x00] & 0x10:
            return [0.0] * 16
        states = output_states(self.registers[0x14:0x18])
        duties = [self.registers[0x02 + n] / 256.0 for n in range(16)]
        group = self.registers[0x12] / 256.0
        return [full_ma * (0.0, 1.0, duty, duty * group)[state] for state, duty in zip(states, duties, strict=True)]

    def shown(self, register: int) -> int:
        """EFLAG1 and 2 (SLDS223A, tables 1 and 2): 1 is normal, and seen only where a channel is fully on.

        MODE2 bit 7 holds over-temperature cleared, which hides it.
        """
        if register not in (0x1D, 0x1E):
            return super().shown(register)
        states = output_states(self.registers[0x14:0x18])
        hot = self.hot and not self.registers[0x01] & 0x80
        first = 8 * (register - 0x1D)
        sound = [states[n] == 0b01 and n not in self.open_channels and not hot for n in range(first, first + 8)]
        return sum(1 << n for n, well in enumerate(sound) if well)


class Max17048Model(RegisterChip):
    """MAX17048: 16-bit registers, high byte first, transfers always walk."""

    def __init__(self, cell_mv: float = 3700.0, charge_percent: float = 50.0) -> None:
        super().__init__(0x20, {0x08: 0x00, 0x09: 0x12}, (0x02, 0x03, 0x04, 0x05, 0x08, 0x09), increment=None)
        self.set_cell(cell_mv, charge_percent)

    def set_cell(self, cell_mv: float, charge_percent: float) -> None:
        """The cell has this voltage and charge now."""
        for register, value in ((0x02, round(cell_mv / 0.078125)), (0x04, round(charge_percent * 256.0))):
            self.registers[register : register + 2] = [value >> 8, value & 0xFF]
