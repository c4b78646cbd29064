"""The shelf: every calibration at its place, the right one in force, and the way back.

The bundles themselves lie in the store's `calibrations/`. What is in force for the mounted gel is the store's active
calibration; the shelf remembers it for the other gels too.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import msgspec

from device.bundle_store import BundleStore
from device.calibration_address import SHORT, Place, content_address, place_of, present_place
from device.calibration_bundle import CalibrationBundle, read_calibration
from device.calibration_slots import Slot, SlotEntry, Slots, read_slots, write_slots
from device.disk_advice import explain_refusal
from device.durable import publish_directory
from device.errors import CalibrationMismatch, NoCalibration, RecordError, StoreError
from hal.board_profile import BoardProfile


@dataclass(frozen=True, slots=True)
class Shelved:
    """A calibration on the shelf, and whether scans use it now."""

    bundle: CalibrationBundle
    entry: SlotEntry
    in_force: bool


class CalibrationShelf:
    """The calibrations of a store.

    Parameters
    ----------
    store : whose calibrations they are
    profile : the instrument as it is now, mounted gel included
    """

    def __init__(self, store: BundleStore, profile: BoardProfile) -> None:
        self._store = store
        self._place = present_place(profile)

    def shelved(self) -> tuple[Shelved, ...]:
        """Every calibration that is readable, by place and version. Errors as for `read_slots`."""
        bundles = {bundle.calibration_id: bundle for bundle in self._store.calibrations().bundles}
        places = {place_of(bundle.record) for bundle in bundles.values()}
        found = []
        for place in sorted(places, key=lambda place: (place.board, place.gel_id, place.lights)):
            slots = self._slots(place)
            found += [
                Shelved(bundles[entry.calibration_id], entry, self._is_active(entry))
                for entry in slots.entries
                if entry.calibration_id in bundles
            ]
        return tuple(found)

    def entry_in_force(self) -> SlotEntry | None:
        """The entry that scans of this instrument use now; None when none fits it."""
        current = self._slots(self._place).current
        return current if current and self._is_active(current) else None

    def put_in_force(self, calibration_id: str) -> SlotEntry:
        """Use a calibration from now on; it must be of this instrument, gel and lights.

        Raises
        ------
        CalibrationMismatch
            It is foreign or stale: says of what it is.
        RecordError, StoreError
            It is not there, damaged, or the choice cannot be stored.
        """
        bundle = self._bundle(calibration_id)
        place = place_of(bundle.record)
        if place != self._place:
            raise CalibrationMismatch(f"calibration {calibration_id} {_difference(place, self._place)}")
        slots = self._slots(place)
        entry = slots.entry_of(calibration_id)
        if entry is None:
            raise RecordError(f"calibration {calibration_id}: the same content is shelved already under another name")
        if content_address(bundle.record) != entry.content:
            raise RecordError(f"calibration {calibration_id}: is not what was shelved under that name: import it anew")
        self._store.activate(calibration_id)
        write_slots(self._store.root, place, msgspec.structs.replace(slots, in_force=entry.version))
        return entry

    def switch(self) -> SlotEntry:
        """Use what was in force when this gel was mounted last, else its newest calibration.

        Raises
        ------
        NoCalibration
            There is none for this instrument, gel and lights; says what is there instead.
        """
        slots = self._slots(self._place)
        wanted = slots.current or (slots.entries[-1] if slots.entries else None)
        if wanted is None:
            raise NoCalibration(self._nothing_fits())
        return self.put_in_force(wanted.calibration_id)

    def roll_back(self) -> SlotEntry:
        """Use the version before the one in force; before the user's first, the factory's.

        Raises
        ------
        NoCalibration
            There is none before it.
        """
        earlier = self._slots(self._place).before
        if earlier is None:
            raise NoCalibration("there is no earlier calibration for this instrument, gel and lights: calibrate anew")
        return self.put_in_force(earlier.calibration_id)

    def take_in(self, folder: Path, slot: Slot, *, adopt: bool = False) -> SlotEntry:
        """Copy a calibration's folder into the store and shelve it; it is not in force yet.

        adopt : take one that carries another instrument's id: this very instrument's, before its store was made anew

        Raises
        ------
        CalibrationMismatch
            It was made by another instrument.
        RecordError, StoreError
            It is damaged, or the disk refused.
        """
        bundle = read_calibration(folder)
        maker = bundle.record.identity.device_id
        if maker != self._store.device_id and not adopt:
            raise CalibrationMismatch(
                f"calibration {bundle.calibration_id} was made by instrument {maker}, this is {self._store.device_id}: "
                "calibrate here, or adopt it if it is the same instrument with a new store"
            )
        place, content = place_of(bundle.record), content_address(bundle.record)
        known = next((entry for entry in self._slots(place).entries if entry.content == content), None)
        if known:
            return known
        self._store.take_calibration(bundle)
        slots = self._slots(place, {bundle.calibration_id: slot})
        entry = slots.entry_of(bundle.calibration_id)
        if entry is None:
            raise StoreError(f"{folder}: was copied and is not in the store: try again")
        return entry

    def give_out(self, calibration_id: str, folder: Path) -> Path:
        """Copy a calibration into a folder, whole or not at all; says where it lies.

        Raises
        ------
        RecordError
            There is no such calibration, or it is damaged.
        StoreError
            The folder cannot be written, or holds it already.
        """
        bundle = self._bundle(calibration_id)
        bundle.verify()
        target, partial = folder / calibration_id, folder / f".{calibration_id}.partial"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(partial, ignore_errors=True)
            shutil.copytree(bundle.directory, partial)
            publish_directory(partial, target)
        except OSError as error:
            shutil.rmtree(partial, ignore_errors=True)
            raise StoreError(f"{target}: cannot be written {explain_refusal(error)}") from error
        return target

    def _slots(self, place: Place, slot_of: dict[str, Slot] | None = None) -> Slots:
        """What is shelved at a place, brought up to what the store holds and what is active there."""
        stored = slots = read_slots(self._store.root, place)
        bundles = [b for b in self._store.calibrations().bundles if place_of(b.record) == place]
        for bundle in sorted(bundles, key=lambda b: b.record.identity.counter):
            slot = (slot_of or {}).get(bundle.calibration_id, "user")
            slots = slots.with_entry(slot, bundle.calibration_id, content_address(bundle.record))
        active = next((entry for entry in slots.entries if self._is_active(entry)), None)
        if active:
            slots = msgspec.structs.replace(slots, in_force=active.version)
        if slots != stored:
            write_slots(self._store.root, place, slots)
        return slots

    def _is_active(self, entry: SlotEntry) -> bool:
        try:
            return self._store.active_calibration().calibration_id == entry.calibration_id
        except (NoCalibration, RecordError):
            return False

    def _bundle(self, calibration_id: str) -> CalibrationBundle:
        for bundle in self._store.calibrations().bundles:
            if bundle.calibration_id == calibration_id:
                return bundle
        raise RecordError(f"there is no calibration {calibration_id} in {self._store.root}: see `retroscan shelf`")

    def _nothing_fits(self) -> str:
        """Why none of the calibrations that are there can be used, the nearest miss first."""
        places = {place_of(bundle.record) for bundle in self._store.calibrations().bundles}
        same_gel = [place for place in places if place.gel_id == self._place.gel_id]
        gels = sorted({place.gel_id for place in places if place.board == self._place.board})
        if same_gel:
            return f"the calibration of gel {self._place.gel_id} {_difference(same_gel[0], self._place)}"
        others = f"; calibrated are {', '.join(gels)}" if gels else ""
        return f"gel {self._place.gel_id} has no calibration on this instrument{others}: run `retroscan calibrate`"


def _difference(theirs: Place, ours: Place) -> str:
    """How a calibration's place differs from the present one, and what to do."""
    if theirs.board != ours.board:
        return f"is foreign: of board {theirs.board}, this is {ours.board}: calibrate here"
    if theirs.gel_id != ours.gel_id:
        return f"is of gel {theirs.gel_id}, mounted is {ours.gel_id}: mount that gel, or calibrate this one"
    return (
        f"is stale: made under lights {theirs.lights[:SHORT]}, they are {ours.lights[:SHORT]} now, moved or renamed: "
        "calibrate anew"
    )
