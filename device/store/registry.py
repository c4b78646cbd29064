"""The registry of calibrations: by board, gel and lights, with versions, activation and rollback.

The bundles themselves lie in the store's `calibrations/`. The store knows the active calibration of the mounted gel;
the registry remembers the active version for the other gels, too.
"""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path

import msgspec

from device.bundles.bundle import partial_name
from device.bundles.calibration import CALIBRATION_MANIFEST, CalibrationBundle, read_calibration
from device.bundles.record import checksum_name
from device.errors import CalibrationMismatch, NoCalibration, RecordError, StoreError
from device.io.atomic import remove_tree_quietly
from device.io.folder import Folder
from device.io.system import explain_os_error
from device.store.registry_file import (
    REGISTRY,
    SHORT,
    CalibrationKey,
    RegistryEntry,
    RegistryFile,
    Slot,
    content_address,
    key_of,
    present_key,
)
from device.store.store import BundleStore
from hal.board_profile import BoardProfile


@dataclass(frozen=True, slots=True)
class RegisteredCalibration:
    """A registered calibration, and whether scans use it now."""

    bundle: CalibrationBundle
    entry: RegistryEntry
    active: bool


class CalibrationRegistry:
    """The calibrations of a store.

    Parameters
    ----------
    store : holds the bundles
    profile : the instrument as it is now, with the mounted gel
    """

    def __init__(self, store: BundleStore, profile: BoardProfile) -> None:
        self._store = store
        self._key = present_key(profile)

    def list(self) -> tuple[RegisteredCalibration, ...]:
        """Return every readable calibration, by key and version. Errors as for `RecordFile.read`."""
        bundles = {bundle.calibration_id: bundle for bundle in self._store.calibrations().bundles}
        keys = {key_of(bundle.record) for bundle in bundles.values()}
        found = []
        for key in sorted(keys, key=lambda key: (key.board, key.gel_id, key.lights)):
            slots = self._registered(key)
            found += [
                RegisteredCalibration(bundles[entry.calibration_id], entry, self._is_active(entry))
                for entry in slots.entries
                if entry.calibration_id in bundles
            ]
        return tuple(found)

    def active_entry(self) -> RegistryEntry | None:
        """Return the entry that scans of this instrument use now; None when none fits."""
        current = self._registered(self._key).current
        return current if current and self._is_active(current) else None

    def activate(self, calibration_id: str) -> RegistryEntry:
        """Make a calibration of this instrument, gel and lights the active one.

        Raises
        ------
        CalibrationMismatch
            It belongs to another board or gel, or the lights have changed; says which.
        RecordError, StoreError
            It is absent, damaged, or the choice cannot be stored.
        """
        bundle = self._bundle(calibration_id)
        key = key_of(bundle.record)
        if key != self._key:
            raise CalibrationMismatch(f"calibration {calibration_id} {_difference(key, self._key)}")
        slots = self._registered(key)
        entry = slots.entry_of(calibration_id)
        if entry is None:
            raise RecordError(f"calibration {calibration_id}: the same content is registered under another id")
        if content_address(bundle.record) != entry.content:
            raise RecordError(f"calibration {calibration_id}: differs from what was registered: import it again")
        self._store.activate(calibration_id)
        REGISTRY.write(self._store.root, msgspec.structs.replace(slots, active=entry.version), key.digest)
        return entry

    def switch(self) -> RegistryEntry:
        """Activate the version that was active when this gel was mounted last, else its newest.

        Raises
        ------
        NoCalibration
            None is stored for this instrument, gel and lights; lists those that are stored.
        """
        slots = self._registered(self._key)
        wanted = slots.current or (slots.entries[-1] if slots.entries else None)
        if wanted is None:
            raise NoCalibration(self._nothing_fits())
        return self.activate(wanted.calibration_id)

    def roll_back(self) -> RegistryEntry:
        """Activate the version before the active one; before the user's first, the factory's.

        Raises
        ------
        NoCalibration
            No earlier one is stored.
        """
        earlier = self._registered(self._key).before
        if earlier is None:
            raise NoCalibration("there is no earlier calibration for this instrument, gel and lights: calibrate again")
        return self.activate(earlier.calibration_id)

    def import_(self, folder: Path, slot: Slot, *, adopt: bool = False) -> RegistryEntry:
        """Copy a calibration's folder into the store and register it; it does not become active.

        adopt : accept another instrument's id: this instrument's own, from before its store was made again

        Raises
        ------
        CalibrationMismatch
            Another instrument made it.
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
        key, content = key_of(bundle.record), content_address(bundle.record)
        known = next((entry for entry in self._registered(key).entries if entry.content == content), None)
        if known:
            return known
        self._store.take_calibration(bundle)
        slots = self._registered(key, {bundle.calibration_id: slot})
        entry = slots.entry_of(bundle.calibration_id)
        if entry is None:
            raise StoreError(f"{folder}: was copied and cannot be found in the store: try again")
        return entry

    def export(self, calibration_id: str, folder: Path) -> Path:
        """Copy a calibration into a folder in one step; returns its path there.

        Raises
        ------
        RecordError
            There is no such calibration, or it is damaged.
        StoreError
            The folder cannot be written, or has it already.
        """
        bundle = self._bundle(calibration_id)
        bundle.verify()
        target = folder / calibration_id
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _copy_out(bundle, folder)
        except OSError as error:
            raise StoreError(f"{target}: cannot be written {explain_os_error(error)}") from error
        return target

    def _registered(self, key: CalibrationKey, slot_of: dict[str, Slot] | None = None) -> RegistryFile:
        """Return the registry file of a key, updated to the bundles of the store and the active one."""
        empty = RegistryFile(board=key.board, gel_id=key.gel_id, lights=key.lights)
        stored = slots = REGISTRY.read(self._store.root, key.digest) or empty
        bundles = [b for b in self._store.calibrations().bundles if key_of(b.record) == key]
        for bundle in sorted(bundles, key=lambda b: b.record.identity.counter):
            slot = (slot_of or {}).get(bundle.calibration_id, "user")
            slots = slots.with_entry(slot, bundle.calibration_id, content_address(bundle.record))
        active = next((entry for entry in slots.entries if self._is_active(entry)), None)
        if active:
            slots = msgspec.structs.replace(slots, active=active.version)
        if slots != stored:
            REGISTRY.write(self._store.root, slots, key.digest)
        return slots

    def _is_active(self, entry: RegistryEntry) -> bool:
        try:
            return self._store.active_calibration().calibration_id == entry.calibration_id
        except (NoCalibration, RecordError):
            return False

    def _bundle(self, calibration_id: str) -> CalibrationBundle:
        for bundle in self._store.calibrations().bundles:
            if bundle.calibration_id == calibration_id:
                return bundle
        raise RecordError(f"no calibration {calibration_id} in {self._store.root}: see `retroscan calibrations`")

    def _nothing_fits(self) -> str:
        """Return why no calibration of the store fits, the nearest miss first."""
        keys = {key_of(bundle.record) for bundle in self._store.calibrations().bundles}
        same_gel = [key for key in keys if key.gel_id == self._key.gel_id]
        gels = sorted({key.gel_id for key in keys if key.board == self._key.board})
        if same_gel:
            return f"the calibration of gel {self._key.gel_id} {_difference(same_gel[0], self._key)}"
        others = f"; calibrated gels are {', '.join(gels)}" if gels else ""
        return f"gel {self._key.gel_id} has no calibration on this instrument{others}: run `retroscan calibrate`"


def _copy_out(bundle: CalibrationBundle, folder: Path) -> None:
    """Copy a bundle into a folder that may be a stranger's memory stick."""
    name, partial = bundle.calibration_id, partial_name(bundle.calibration_id)
    if os.path.lexists(folder / name):
        raise FileExistsError(errno.EEXIST, "it is there already", str(folder / name))
    remove_tree_quietly(folder / partial)
    with Folder(bundle.directory) as source, Folder(folder) as target:
        target.make_folder(partial)
        for file in (*bundle.record.files, CALIBRATION_MANIFEST, checksum_name(CALIBRATION_MANIFEST)):
            with source.opened(file) as stream:
                target.write(f"{partial}/{file}", stream)
        target.rename(partial, name)


def _difference(theirs: CalibrationKey, ours: CalibrationKey) -> str:
    """Return how a calibration's key differs from the present one, and what to do."""
    if theirs.board != ours.board:
        return f"is foreign: made for board {theirs.board}, this is {ours.board}: calibrate here"
    if theirs.gel_id != ours.gel_id:
        return f"is of gel {theirs.gel_id}, mounted is {ours.gel_id}: mount that gel, or calibrate this one"
    return (
        f"is stale: made under lights {theirs.lights[:SHORT]}, now {ours.lights[:SHORT]}: "
        "lights were moved or renamed, calibrate again"
    )
