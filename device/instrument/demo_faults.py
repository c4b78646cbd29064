"""The faults of the twin that a demonstration switches: those of its world, and a disk without room."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, Literal

from device.instrument.instrument import Instrument
from hal.interfaces import FaultName

DemoFault = FaultName | Literal["storage"]

DEMO_FAULTS: Final[tuple[tuple[DemoFault, str], ...]] = (
    ("dim", "the blue light is 10 % weaker"),
    ("break", "the blue light is broken"),
    ("wobble", "the hand wobbles"),
    ("dirt", "dust on the skin"),
    ("tilt", "the next objects are pressed at an angle"),
    ("depth", "the next objects are pressed too deep"),
    ("battery", "the battery is nearly empty"),
    ("storage", "no room for another scan"),
    ("stall", "the camera delivers no more frames"),
)
"""Every fault by name, in words."""


class DemoDisk:
    """The disk of a store, which can be shown as full."""

    def __init__(self) -> None:
        self.is_full = False

    def __call__(self, path: Path) -> os.statvfs_result:
        """As `os.statvfs`, without free blocks while full."""
        found = os.statvfs(path)
        if not self.is_full:
            return found
        fields = list(found)
        fields[3] = fields[4] = 0  # free blocks, for the system and for everybody
        return os.statvfs_result(fields)


class DemoFaults:
    """Which faults are on, and the switch of each.

    Parameters
    ----------
    instrument : a twin
    disk : of its store
    """

    def __init__(self, instrument: Instrument, disk: DemoDisk) -> None:
        self._instrument = instrument
        self._disk = disk
        self.active: set[DemoFault] = set()

    def toggle(self, name: DemoFault) -> None:
        """Switch a fault on, or off again."""
        self.active ^= {name}
        on = name in self.active
        if name == "storage":
            self._disk.is_full = on
        else:
            self._instrument.set_fault(name, on)
