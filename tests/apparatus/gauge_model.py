"""Register model of the fuel gauge, written from its data sheet, not from the driver."""

from __future__ import annotations

from hal.simulator.led_chips import RegisterChip


class Max17048Model(RegisterChip):
    """MAX17048: 16-bit registers, high byte first, transfers always auto-increment."""

    def __init__(self, cell_mv: float = 3700.0, charge_percent: float = 50.0) -> None:
        super().__init__(0x20, {0x08: 0x00, 0x09: 0x12}, (0x02, 0x03, 0x04, 0x05, 0x08, 0x09), increment=None)
        self.set_cell(cell_mv, charge_percent)

    def set_cell(self, cell_mv: float, charge_percent: float) -> None:
        """Set voltage and charge of the cell."""
        for register, value in ((0x02, round(cell_mv / 0.078125)), (0x04, round(charge_percent * 256.0))):
            self.registers[register : register + 2] = [value >> 8, value & 0xFF]
