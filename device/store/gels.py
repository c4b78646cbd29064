"""The mounted gel and the presses of each gel: small files of the store, replaced in one step."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import msgspec

from device.bundles.record import BundleId, Count, Record, encode_record
from device.errors import RecordError
from device.store.record_file import RecordFile
from hal.board_profile import GelConfig

_REMEDY: Final = "remove it and name the gel again with `retroscan gel`"


class GelRecord(Record, frozen=True, tag_field="schema", tag="retrograph.gel/1"):
    """A gel of this instrument: thickness of its slab (mm) and its count of presses."""

    gel_id: BundleId
    slab_thickness_mm: Annotated[float, msgspec.Meta(gt=0, le=100)]
    presses: Count = 0


class MountedGel(Record, frozen=True, tag_field="schema", tag="retrograph.mounted-gel/1"):
    """The gel that the operator said is mounted."""

    gel_id: BundleId


GELS: Final = RecordFile(GelRecord, "gels/{}.json", _REMEDY)
MOUNTED: Final = RecordFile(MountedGel, "mounted-gel.json", _REMEDY)


def mounted_gel(root: Path, usual: GelConfig) -> GelRecord:
    """The mounted gel: the one that was named last, else the board's own.

    Raises
    ------
    RecordError
        A file is damaged.
    """
    mounted = MOUNTED.read(root)
    gel_id = mounted.gel_id if mounted else usual.id
    return known_gel(root, gel_id) or GelRecord(gel_id=gel_id, slab_thickness_mm=usual.slab_thickness_mm)


def known_gel(root: Path, gel_id: str) -> GelRecord | None:
    """The record of a gel, None when it was never mounted. Errors as for `mounted_gel`."""
    return GELS.read(root, gel_id)


def known_gels(root: Path) -> tuple[GelRecord, ...]:
    """Every gel that was mounted here, by name; damaged files are left out."""
    return tuple(GELS.all_sound(root))


def mount_gel(root: Path, gel: GelRecord) -> None:
    """Store that this gel is mounted.

    Raises
    ------
    StoreError
        The disk refused.
    """
    GELS.write(root, gel, gel.gel_id)
    MOUNTED.write(root, MountedGel(gel_id=gel.gel_id))


def count_gel_press(root: Path, usual: GelConfig) -> GelRecord:
    """The mounted gel after one more press, stored. Errors as for `mounted_gel` and `mount_gel`."""
    gel = mounted_gel(root, usual)
    pressed = msgspec.structs.replace(gel, presses=gel.presses + 1)
    GELS.write(root, pressed, gel.gel_id)
    return pressed


def make_gel(gel_id: str, slab_thickness_mm: float) -> GelRecord:
    """A gel of that name and thickness.

    Raises
    ------
    RecordError
        The name or the thickness is out of range.
    """
    try:
        return msgspec.json.decode(
            encode_record(GelRecord(gel_id=gel_id, slab_thickness_mm=slab_thickness_mm)), type=GelRecord
        )
    except msgspec.ValidationError as error:
        raise RecordError(
            f"gel {gel_id!r}: use lower-case letters, digits and hyphens, and a thickness over 0 and up to 100 mm"
        ) from error
