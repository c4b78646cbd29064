"""One place of the shelf: the factory's calibration, the user's by version, and which of them is in force."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from device.calibration_address import Place
from device.disk_advice import explain_refusal
from device.durable import replace_file
from device.errors import StoreError
from device.records import BundleId, Record, Sha256, decode_record, encode_record, read_small

SHELF: Final = "calibration-slots"
_REMEDY: Final = "remove it: it is made anew from the calibrations that are there"

Slot = Literal["factory", "user"]


class SlotEntry(Record, frozen=True):
    """One calibration in its slot; versions count from 1 within a place and are never given again."""

    slot: Slot
    version: Annotated[int, msgspec.Meta(ge=1)]
    calibration_id: BundleId
    content: Sha256


class Slots(Record, frozen=True, tag_field="schema", tag="retrograph.calibration-slots/1"):
    """A place of the shelf.

    entries : in order of version
    in_force : version that scans of this place use, or None
    """

    board: str
    gel_id: str
    lights: str
    entries: tuple[SlotEntry, ...] = ()
    in_force: int | None = None

    @property
    def current(self) -> SlotEntry | None:
        """The entry in force."""
        return next((entry for entry in self.entries if entry.version == self.in_force), None)

    @property
    def before(self) -> SlotEntry | None:
        """What a rollback would put in force: the version before, and before the first the factory's."""
        current = self.current
        if current is None or current.slot == "factory":
            return None
        users = [entry for entry in self.entries if entry.slot == "user" and entry.version < current.version]
        factory = [entry for entry in self.entries if entry.slot == "factory"]
        earlier = users or factory
        return earlier[-1] if earlier else None

    def with_entry(self, slot: Slot, calibration_id: str, content: str) -> Slots:
        """The place with one calibration more; content that is there already is not shelved twice."""
        if any(entry.content == content for entry in self.entries):
            return self
        version = max((entry.version for entry in self.entries), default=0) + 1
        entry = SlotEntry(slot=slot, version=version, calibration_id=calibration_id, content=content)
        return msgspec.structs.replace(self, entries=(*self.entries, entry))

    def entry_of(self, calibration_id: str) -> SlotEntry | None:
        """The entry of a calibration."""
        return next((entry for entry in self.entries if entry.calibration_id == calibration_id), None)


def read_slots(root: Path, place: Place) -> Slots:
    """What is shelved at a place; empty when nothing ever was.

    Raises
    ------
    RecordError
        The file is damaged.
    """
    path = root / SHELF / place.file_name
    if not path.exists():
        return Slots(board=place.board, gel_id=place.gel_id, lights=place.lights)
    return decode_record(read_small(path, _REMEDY), Slots, path, _REMEDY)


def write_slots(root: Path, place: Place, slots: Slots) -> None:
    """Store a place durably.

    Raises
    ------
    StoreError
        The disk refused; the file is as it was.
    """
    path = root / SHELF / place.file_name
    try:
        path.parent.mkdir(exist_ok=True)
        replace_file(path, encode_record(slots))
    except OSError as error:
        raise StoreError(f"{path}: cannot be stored {explain_refusal(error)}") from error
