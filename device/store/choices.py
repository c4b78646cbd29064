"""Choices of the operator, small files so that they survive a restart: settings, labels, presets, marks, exposure.

What is damaged counts as not there, and the usual choice holds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Generic, Literal, TypeVar

import msgspec

from device.bundles.fingerprint import SettingsRecord
from device.bundles.record import BundleId, Count, Positive, Record, ShortText, decode_record, encode_record, read_small
from device.bundles.scan import Annotations, CaptureMode
from device.errors import RecordError, StoreError
from device.io.atomic import replace_file
from device.io.system import explain_os_error
from hal.board_profile import BoardProfile, GelConfig
from hal.hardware import Hardware

# A small record of the store as a file that is replaced in one step.

Kept = TypeVar("Kept", bound=Record)


@dataclass(frozen=True, slots=True)
class RecordFile(Generic[Kept]):
    """One record in a store, or one for each name.

    kind : type of the record
    place : its path below the store, where {} is the name
    remedy : what a person does about a damaged file
    mode : permissions as for `replace_file`
    """

    kind: type[Kept]
    place: str
    remedy: str
    mode: int | None = None

    def path(self, root: Path, name: str = "") -> Path:
        """Return the path of the file, there or not."""
        return root / self.place.format(name)

    def read(self, root: Path, name: str = "") -> Kept | None:
        """Return the record; None when there is none.

        Raises
        ------
        RecordError
            The file is damaged.
        """
        return self._decoded(path) if (path := self.path(root, name)).exists() else None

    def read_sound(self, root: Path, name: str = "") -> Kept | None:
        """Return the record; None when there is none or its file is damaged."""
        try:
            return self.read(root, name)
        except RecordError:
            return None

    def all_sound(self, root: Path) -> list[Kept]:
        """Return the records of all names, by name; damaged ones are left out."""
        pattern = self.path(root, "*")
        names = sorted(path.stem for path in pattern.parent.glob(pattern.name))
        return [record for name in names if (record := self.read_sound(root, name)) is not None]

    def write(self, root: Path, record: Kept, name: str = "") -> None:
        """Store a record durably.

        Raises
        ------
        StoreError
            The disk refused; the one before is kept.
        """
        path = self.path(root, name)
        try:
            path.parent.mkdir(exist_ok=True)
            replace_file(path, encode_record(record), self.mode)
        except OSError as error:
            raise StoreError(f"{path}: cannot be stored {explain_os_error(error)}") from error

    def remove(self, root: Path) -> None:
        """Remove the file.

        Raises
        ------
        StoreError
            The disk refused.
        """
        path = self.path(root)
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise StoreError(f"{path}: cannot be removed {explain_os_error(error)}") from error

    def _decoded(self, path: Path) -> Kept:
        return decode_record(read_small(path, self.remedy), self.kind, path, self.remedy)


Display = Literal["dark", "light"]
Opinion = Literal["good", "bad"]
MAX_PRESETS: Final = 20


class Settings(Record, frozen=True, tag_field="schema", tag="retrograph.settings/1"):
    """Settings that hold until they are changed.

    capture : how presses are taken
    number_parts : whether the part's number grows with every scan
    display : colours of the screens
    """

    capture: CaptureMode = "single"
    number_parts: bool = False
    display: Display = "dark"


class StickyAnnotations(Record, frozen=True, tag_field="schema", tag="retrograph.annotations/1"):
    """Annotations that are stored with every scan until they are changed."""

    annotations: Annotations = Annotations()


class Presets(Record, frozen=True, tag_field="schema", tag="retrograph.presets/1"):
    """Labels that were stored to be chosen again."""

    items: Annotated[tuple[Annotations, ...], msgspec.Meta(max_length=MAX_PRESETS)] = ()


class ScanMark(Record, frozen=True, tag_field="schema", tag="retrograph.mark/1"):
    """A person's opinion of a scan (None: no opinion) and a note."""

    scan_id: BundleId
    opinion: Opinion | None = None
    note: Annotated[str, msgspec.Meta(max_length=1000)] = ""


class BalanceRecord(Record, frozen=True, tag_field="schema", tag="retrograph.exposure-balance/1"):
    """Exposure and currents for the next calibration of a gel on a board.

    currents_ma : of each light by its name, mA
    """

    board: ShortText
    gel_id: BundleId
    settings: SettingsRecord
    currents_ma: Annotated[dict[ShortText, Positive], msgspec.Meta(min_length=3, max_length=3)]


SETTINGS: Final = RecordFile(Settings, "settings.json", "remove it, and choose the settings again")
STICKY: Final = RecordFile(StickyAnnotations, "annotations.json", "remove it, and enter job, part and operator again")
PRESETS: Final = RecordFile(Presets, "presets.json", "remove it, and store the presets again")
MARKS: Final = RecordFile(ScanMark, "marks/{}.json", "remove it and mark the scan again")
BALANCE: Final = RecordFile(BalanceRecord, "exposure-balance.json", "remove it, and balance the exposure again")


def read_settings(root: Path) -> Settings:
    """Return the settings; the usual ones when there are none or their file is damaged."""
    return SETTINGS.read_sound(root) or Settings()


def read_sticky(root: Path) -> Annotations:
    """Return the annotations of the next scans; empty when there are none or their file is damaged."""
    return (STICKY.read_sound(root) or StickyAnnotations()).annotations


def write_sticky(root: Path, annotations: Annotations) -> None:
    """Store the annotations of the next scans. Errors as for `RecordFile.write`."""
    STICKY.write(root, StickyAnnotations(annotations=annotations))


def read_presets(root: Path) -> tuple[Annotations, ...]:
    """Return the presets, newest first; none when there are none or their file is damaged."""
    return (PRESETS.read_sound(root) or Presets()).items


def add_preset(root: Path, preset: Annotations) -> None:
    """Store a preset as the newest; the oldest of more than `MAX_PRESETS` goes. Errors as for `RecordFile.write`."""
    others = tuple(item for item in read_presets(root) if item != preset)
    PRESETS.write(root, Presets(items=(preset, *others)[:MAX_PRESETS]))


def write_mark(root: Path, mark: ScanMark) -> None:
    """Store a mark beside the scans, which never change.

    Raises
    ------
    RecordError
        There is no such scan.
    StoreError
        The disk refused; the mark before is kept.
    """
    if not (root / "scans" / mark.scan_id).is_dir():
        raise RecordError(f"there is no scan {mark.scan_id} in {root}: choose one from the history")
    MARKS.write(root, mark, mark.scan_id)


# The mounted gel and the presses of each gel: small files of the store, replaced in one step.

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
    """Return the mounted gel: the one that was named last, else the board's own.

    Raises
    ------
    RecordError
        A file is damaged.
    """
    mounted = MOUNTED.read(root)
    gel_id = mounted.gel_id if mounted else usual.id
    return known_gel(root, gel_id) or GelRecord(gel_id=gel_id, slab_thickness_mm=usual.slab_thickness_mm)


def known_gel(root: Path, gel_id: str) -> GelRecord | None:
    """Return the record of a gel, None when it was never mounted. Errors as for `mounted_gel`."""
    return GELS.read(root, gel_id)


def known_gels(root: Path) -> tuple[GelRecord, ...]:
    """Return every gel that was mounted here, by name; damaged files are left out."""
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
    """Return the mounted gel after one more press, stored. Errors as for `mounted_gel` and `mount_gel`."""
    gel = mounted_gel(root, usual)
    pressed = msgspec.structs.replace(gel, presses=gel.presses + 1)
    GELS.write(root, pressed, gel.gel_id)
    return pressed


def make_gel(gel_id: str, slab_thickness_mm: float) -> GelRecord:
    """Return a gel of that name and thickness.

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


def with_active_gel(hardware: Hardware, root: Path) -> Hardware:
    """Return the same devices, with the mounted gel in the profile instead of the board's default gel.

    Raises
    ------
    RecordError
        The store's gel record is damaged.
    """
    return replace(hardware, profile=profile_with_mounted_gel(hardware.profile, root))


def profile_with_mounted_gel(profile: BoardProfile, root: Path) -> BoardProfile:
    """Return the board profile with the mounted gel. Errors as for `with_active_gel`."""
    gel = mounted_gel(root, profile.gel)
    mounted = GelConfig(id=gel.gel_id, slab_thickness_mm=gel.slab_thickness_mm)
    return msgspec.structs.replace(profile, gel=mounted)
