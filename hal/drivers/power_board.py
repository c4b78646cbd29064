"""Supply and battery of a board: the firmware's throttle bits and a MAX17048 fuel gauge."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final, Self

from hal.drivers.i2c_bus import I2cChip
from hal.errors import PowerError
from hal.interfaces import PowerReading

THROTTLED_FILE: Final = Path("/sys/devices/platform/soc/soc:firmware/get_throttled")
UNDER_VOLTAGE: Final = 1 << 0
THROTTLED: Final = 1 << 2
WAS_UNDER_VOLTAGE: Final = 1 << 16

VCELL: Final = 0x02
SOC: Final = 0x04
VERSION: Final = 0x08
VERSION_FAMILY: Final = 0x0010
MV_PER_STEP: Final = 0.078125
STEPS_PER_PERCENT: Final = 256.0


class Max17048:
    """A MAX17048 fuel gauge: cell voltage and charge."""

    def __init__(self, chip: I2cChip) -> None:
        self._chip = chip

    def read(self) -> tuple[float, float]:
        """Return the cell voltage (mV) and the charge (0 to 1).

        The gauge may report a charge slightly above 1, which is clipped.

        Raises
        ------
        PowerError
            The gauge does not answer, or another chip does.
        """
        version = self._word(VERSION)
        if version & 0xFFF0 != VERSION_FAMILY:
            raise PowerError(
                f"the {self._chip.place} reports version 0x{version:04x}, not a MAX17048: check power.fuel_gauge"
            )
        charge = self._word(SOC) / STEPS_PER_PERCENT / 100.0
        return self._word(VCELL) * MV_PER_STEP, min(charge, 1.0)

    def close(self) -> None:
        """Release the bus."""
        self._chip.close()

    def _word(self, register: int) -> int:
        return int.from_bytes(self._chip.read(register, 2, "battery"), "big")


class BoardPower:
    """See `hal.interfaces.Power`.

    Parameters
    ----------
    throttled_text : the firmware's throttle flags, such as "50005" or "throttled=0x0"; None when not available
    gauge : the fuel gauge, if there is one
    """

    def __init__(self, throttled_text: Callable[[], str] | None, gauge: Max17048 | None) -> None:
        self._throttled_text = throttled_text
        self._gauge = gauge

    def read(self) -> PowerReading:
        """Read firmware and gauge, each on its own."""
        reading, complaints = PowerReading(), []
        if self._throttled_text is not None:
            try:
                reading = throttle_reading(self._throttled_text())
            except PowerError as error:
                complaints.append(str(error))
        if self._gauge is not None:
            try:
                battery_mv, battery_share = self._gauge.read()
                reading = replace(reading, battery_mv=battery_mv, battery_share=battery_share)
            except PowerError as error:
                complaints.append(str(error))
        return replace(reading, complaints=tuple(complaints))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._gauge is not None:
            self._gauge.close()


def throttle_reading(text: str) -> PowerReading:
    """Decode the throttle bits of the firmware.

    Raises
    ------
    PowerError
        They are not a hexadecimal number.
    """
    try:
        bits = int(text.strip().removeprefix("throttled="), 16)
    except ValueError as error:
        raise PowerError(f"the firmware's throttle bits are {text!r}, not a number: update the firmware") from error
    return PowerReading(
        under_voltage=bool(bits & UNDER_VOLTAGE),
        was_under_voltage=bool(bits & WAS_UNDER_VOLTAGE),
        throttled=bool(bits & THROTTLED),
    )


def read_throttled_file(path: Path = THROTTLED_FILE) -> str:
    """Return the throttle bits from the kernel.

    Raises
    ------
    PowerError
        The kernel has no such file: it is not a Raspberry Pi kernel.
    """
    try:
        return path.read_text(encoding="ascii")
    except OSError as error:
        raise PowerError(
            f"{path} cannot be read ({error.strerror}): run a Raspberry Pi kernel, or set power.throttled to vcgencmd"
        ) from error


def run_vcgencmd(program: str = "vcgencmd") -> str:
    """Return the throttle bits from the firmware's own tool.

    Raises
    ------
    PowerError
        The tool is missing, fails or hangs.
    """
    try:
        ran = subprocess.run([program, "get_throttled"], capture_output=True, text=True, check=True, timeout=2.0)  # noqa: S603
    except (OSError, subprocess.SubprocessError) as error:
        raise PowerError(f"{program} failed ({error}): install it, or set power.throttled to sysfs") from error
    return ran.stdout
