"""What a calibration is of, and what it is: the place on the shelf, and the address of its content."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

import msgspec

from device.calibration_bundle import CalibrationRecord
from device.fingerprint import Fingerprint
from device.records import encode_record, sha256_bytes
from hal.board_profile import BoardProfile

SHORT: Final = 12
"""Hex digits of a digest that people read."""


@dataclass(frozen=True, slots=True)
class Place:
    """Instrument (its board), gel, and lights: a calibration of one place is no use in another.

    lights : digest of channel order, orientation, frame size, and name, colour and place of each light; not of their
        currents, which each calibration sets for itself
    """

    board: str
    gel_id: str
    lights: str

    @property
    def file_name(self) -> str:
        """Name of the place's file: no board and gel can be named so that two places meet."""
        return f"{sha256_bytes(repr((self.board, self.gel_id, self.lights)).encode())[:24]}.json"


def place_of(record: CalibrationRecord) -> Place:
    """The place of a calibration."""
    return Place(record.board, record.gel_id, lights_digest(record.fingerprint, record.shape))


def present_place(profile: BoardProfile) -> Place:
    """The place of an instrument as its profile has it now, mounted gel included."""
    fingerprint = Fingerprint.of(profile, profile.camera.settings, profile.currents_ma)
    shape = (profile.sensor.rows, profile.sensor.columns)
    return Place(profile.name, profile.gel.id, lights_digest(fingerprint, shape))


def lights_digest(fingerprint: Fingerprint, shape: tuple[int, int]) -> str:
    """Digest of how colour comes about, settings left out; the first digits of a SHA-256."""
    lights = [(light.name, light.colour, [round(mm, 2) for mm in light.position_mm]) for light in fingerprint.lights]
    told = [fingerprint.channel_order, fingerprint.orientation, list(shape), lights]
    return sha256_bytes(msgspec.json.encode(told))[:SHORT]


def content_address(record: CalibrationRecord) -> str:
    """SHA-256 of all that a calibration says and of all its files, but not of its name and date.

    The same frames and the same model have the same address, wherever they were brought from.
    """
    nameless = msgspec.structs.replace(
        record.identity, id="content", device_id="content", boot_id="content", counter=0, monotonic_ns=0
    )
    timeless = msgspec.structs.replace(record, identity=nameless, created=datetime.fromtimestamp(0, UTC))
    return sha256_bytes(encode_record(timeless))
