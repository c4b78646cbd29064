"""Files of the registry of calibrations: its versions by board, gel and lights, and the active one."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from device.bundles.calibration import CalibrationBundle, CalibrationRecord, read_calibration
from device.bundles.fingerprint import Fingerprint
from device.bundles.record import BundleId, Count, Record, Sha256, ShortText, encode_record, sha256_bytes
from device.errors import NoCalibration
from device.io.system import FILE_MODE
from device.store.choices import RecordFile
from hal.board_profile import BoardProfile

_ACTIVATE_AGAIN: Final = (
    "remove it, then activate a calibration again with `retroscan calibrations use ID` (`retroscan calibrations` lists "
    "them), or run `retroscan calibrate`"
)


class ActiveCalibration(Record, frozen=True, tag_field="schema", tag="retrograph.active/1"):
    """The id of the active calibration."""

    calibration_id: BundleId


ACTIVE: Final = RecordFile(ActiveCalibration, "active.json", _ACTIVATE_AGAIN, FILE_MODE)


def read_active(root: Path) -> CalibrationBundle:
    """Return the active calibration of a store.

    Raises
    ------
    NoCalibration
        None was activated, or the active one is gone.
    RecordError
        The choice or the calibration is damaged.
    """
    active = ACTIVE.read(root)
    if active is None:
        raise NoCalibration(f"no calibration is active in {root}: run `retroscan calibrate` first")
    directory = root / "calibrations" / active.calibration_id
    if not directory.is_dir():
        raise NoCalibration(f"the active calibration {active.calibration_id} is gone: run `retroscan calibrate` again")
    return read_calibration(directory)


Slot = Literal["factory", "user"]


class RegistryEntry(Record, frozen=True):
    """One registered calibration; versions count from 1 within a file and are never reused."""

    slot: Slot
    version: Annotated[int, msgspec.Meta(ge=1, le=1 << 31)]
    calibration_id: BundleId
    content: Sha256


class RegistryFile(Record, frozen=True, tag_field="schema", tag="retrograph.calibration-slots/1"):
    """The calibrations of one key.

    entries : in order of version
    active : version that scans use, or None
    """

    board: ShortText
    gel_id: ShortText
    lights: ShortText
    entries: tuple[RegistryEntry, ...] = ()
    active: Count | None = None

    @property
    def current(self) -> RegistryEntry | None:
        """The active entry."""
        return next((entry for entry in self.entries if entry.version == self.active), None)

    @property
    def before(self) -> RegistryEntry | None:
        """The entry that a rollback activates: the version before, or the factory's before the user's first."""
        current = self.current
        if current is None or current.slot == "factory":
            return None
        users = [entry for entry in self.entries if entry.slot == "user" and entry.version < current.version]
        factory = [entry for entry in self.entries if entry.slot == "factory"]
        earlier = users or factory
        return earlier[-1] if earlier else None

    def with_entry(self, slot: Slot, calibration_id: str, content: str) -> RegistryFile:
        """Return the same with one more calibration; content that is registered already is not added twice."""
        if any(entry.content == content for entry in self.entries):
            return self
        version = max((entry.version for entry in self.entries), default=0) + 1
        entry = RegistryEntry(slot=slot, version=version, calibration_id=calibration_id, content=content)
        return msgspec.structs.replace(self, entries=(*self.entries, entry))

    def entry_of(self, calibration_id: str) -> RegistryEntry | None:
        """Return the entry of a calibration."""
        return next((entry for entry in self.entries if entry.calibration_id == calibration_id), None)


REGISTRY: Final = RecordFile(
    RegistryFile, "calibration-slots/{}.json", "remove it: it is rebuilt from the calibrations of the store"
)


SHORT: Final = 12
"""Hex digits of a digest as people see it."""


@dataclass(frozen=True, slots=True)
class CalibrationKey:
    """Board, gel and lights: a calibration is only valid for its own key.

    lights : digest of channel order, orientation, frame size, and name, colour and position of each light; not of
        currents, which each calibration sets
    """

    board: str
    gel_id: str
    lights: str

    @property
    def digest(self) -> str:
        """Name of the key in `REGISTRY`; a digest, so that no names of board and gel can make two keys collide."""
        return sha256_bytes(repr((self.board, self.gel_id, self.lights)).encode())[:24]


def key_of(record: CalibrationRecord) -> CalibrationKey:
    """Return the key of a calibration."""
    return CalibrationKey(record.board, record.gel_id, lights_digest(record.fingerprint, record.shape))


def present_key(profile: BoardProfile) -> CalibrationKey:
    """Return the key of an instrument as its profile is now, with the mounted gel."""
    fingerprint = Fingerprint.of(profile, profile.camera.settings, profile.currents_ma)
    shape = (profile.sensor.rows, profile.sensor.columns)
    return CalibrationKey(profile.name, profile.gel.id, lights_digest(fingerprint, shape))


def lights_digest(fingerprint: Fingerprint, shape: tuple[int, int]) -> str:
    """Return the digest of a fingerprint without camera settings and currents; the first digits of a SHA-256."""
    lights = [(light.name, light.colour, [round(mm, 2) for mm in light.position_mm]) for light in fingerprint.lights]
    facts = [fingerprint.channel_order, fingerprint.orientation, list(shape), lights]
    return sha256_bytes(msgspec.json.encode(facts))[:SHORT]


def content_address(record: CalibrationRecord) -> str:
    """SHA-256 of a calibration's record and files without its id and date.

    The same frames and the same model have the same address, whatever id they were imported under.
    """
    nameless = msgspec.structs.replace(
        record.identity, id="content", device_id="content", boot_id="content", counter=0, monotonic_ns=0
    )
    timeless = msgspec.structs.replace(record, identity=nameless, created=datetime.fromtimestamp(0, UTC))
    return sha256_bytes(encode_record(timeless))
