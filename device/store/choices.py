"""Choices of the operator, small files so that they survive a restart: settings, labels, presets, marks, exposure.

What is damaged counts as not there, and the usual choice holds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from device.bundles.fingerprint import SettingsRecord
from device.bundles.record import BundleId, Positive, Record, ShortText
from device.bundles.scan import Annotations, CaptureMode
from device.errors import RecordError
from device.store.record_file import RecordFile

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
    """The settings; the usual ones when there are none or their file is damaged."""
    return SETTINGS.read_sound(root) or Settings()


def read_sticky(root: Path) -> Annotations:
    """The annotations of the next scans; empty when there are none or their file is damaged."""
    return (STICKY.read_sound(root) or StickyAnnotations()).annotations


def write_sticky(root: Path, annotations: Annotations) -> None:
    """Store the annotations of the next scans. Errors as for `RecordFile.write`."""
    STICKY.write(root, StickyAnnotations(annotations=annotations))


def read_presets(root: Path) -> tuple[Annotations, ...]:
    """The presets, newest first; none when there are none or their file is damaged."""
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
