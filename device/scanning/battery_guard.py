"""When the battery is too low to go on: the device then shuts down in order, long before the voltage falls away."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from device.errors import DeviceError
from hal.errors import PowerError
from hal.interfaces import Clock, Power, PowerReading

EMPTY_SHARE: Final = 0.05
EMPTY_MV: Final = 3300.0
"""A lithium cell below this falls fast; the gauge's charge may be wrong, its voltage is not."""

LOW_IN_A_ROW: Final = 3
EVERY_S: Final = 10.0


class NothingToGuard(DeviceError, LookupError):
    """The board measures no battery. Take the guard out, or wire a gauge and state it in the board profile."""


def is_low(reading: PowerReading) -> bool:
    """Whether this reading says that the battery is empty; what is not measured says nothing."""
    low_share = reading.battery_share is not None and reading.battery_share <= EMPTY_SHARE
    low_voltage = reading.battery_mv is not None and reading.battery_mv <= EMPTY_MV
    return low_share or low_voltage


def wait_until_low(power: Power, clock: Clock, complain: Callable[[object], None]) -> PowerReading:
    """The reading that settles it: the battery was low in `LOW_IN_A_ROW` readings on end.

    A gauge that does not answer for once is complained of and counts as nothing: neither low nor well.
    """
    low = 0
    while True:
        try:
            reading = power.read()
        except PowerError as error:
            complain(error)
        else:
            low = low + 1 if is_low(reading) else 0
            if low >= LOW_IN_A_ROW:
                return reading
        clock.sleep(EVERY_S)
