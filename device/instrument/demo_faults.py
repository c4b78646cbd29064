"""The faults of the twin that a demonstration switches: those of its world, and a disk without room."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Final, Literal

from device.instrument.instrument import Instrument
from device.store.store import RESERVE_BYTES
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
    """The disk of a store, which can be shown as full: then only what is removed from the store makes room.

    Parameters
    ----------
    store : folder of the store
    """

    def __init__(self, store: Path) -> None:
        self._store = store
        self._held_bytes: int | None = None

    def fill(self, on: bool) -> None:
        """Show the disk as full from now on, the system's reserve excluded, or as it is."""
        self._held_bytes = _held_bytes(self._store) if on else None

    def __call__(self, path: Path) -> os.statvfs_result:
        """As `os.statvfs`; while full, free are the reserve and what was removed from the store since."""
        found = os.statvfs(path)
        if self._held_bytes is None:
            return found
        freed = self._held_bytes - _held_bytes(self._store)
        fields = list(found)
        fields[3] = fields[4] = max(RESERVE_BYTES + freed, 0) // found.f_frsize  # for the system and for everybody
        return os.statvfs_result(fields)


def _held_bytes(folder: Path) -> int:
    """Return the size of all files under a folder, bytes; those that vanish meanwhile count nothing."""
    total = 0
    for path in folder.rglob("*"):
        with suppress(OSError):
            total += path.lstat().st_size if not path.is_dir() else 0
    return total


class DemoFaults:
    """Faults that are on, and the switch of each.

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
            self._disk.fill(on)
        else:
            self._instrument.set_fault(name, on)
