"""The twin's supply: good unless it is made bad; it has no battery."""

from __future__ import annotations

from typing import Self

from hal.interfaces import PowerReading
from hal.twin.bench import Bench


class TwinPower:
    """See `hal.interfaces.Power`."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def read(self) -> PowerReading:
        """The supply as the bench's faults have it."""
        low = self._bench.faults.under_voltage
        return PowerReading(under_voltage=low, was_under_voltage=low, throttled=low)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None
