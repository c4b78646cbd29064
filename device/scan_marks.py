"""What a person says of a scan after it was published: a small file beside the scans, since those never change."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from device.disk_advice import explain_refusal
from device.durable import replace_file
from device.errors import RecordError, StoreError
from device.records import BundleId, Record, decode_record, encode_record, read_small

MARKS: Final = "marks"
MARK_SCHEMA: Final = "retrograph.mark/1"
_REMEDY: Final = "remove it and mark the scan again"

Opinion = Literal["good", "bad"]


class ScanMark(Record, frozen=True, tag_field="schema", tag=MARK_SCHEMA):
    """Good or bad in a person's eyes (None: no opinion), and a note."""

    scan_id: BundleId
    opinion: Opinion | None = None
    note: Annotated[str, msgspec.Meta(max_length=1000)] = ""


def mark_path(root: Path, scan_id: str) -> Path:
    """Where the mark of a scan lies, if it has one."""
    return root / MARKS / f"{scan_id}.json"


def read_mark(root: Path, scan_id: str) -> ScanMark | None:
    """The mark of a scan; None when there is none, or when its file is damaged: it is an opinion, not a measurement."""
    path = mark_path(root, scan_id)
    if not path.exists():
        return None
    try:
        return decode_record(read_small(path, _REMEDY), ScanMark, path, _REMEDY)
    except RecordError:
        return None


def write_mark(root: Path, mark: ScanMark) -> None:
    """Store a mark durably, in the place of the one before.

    Raises
    ------
    RecordError
        There is no such scan.
    StoreError
        The disk refused; the mark before stands.
    """
    if not (root / "scans" / mark.scan_id).is_dir():
        raise RecordError(f"there is no scan {mark.scan_id} in {root}: choose one of the history")
    path = mark_path(root, mark.scan_id)
    try:
        path.parent.mkdir(exist_ok=True)
        replace_file(path, encode_record(mark))
    except OSError as error:
        raise StoreError(f"{path}: the mark cannot be stored {explain_refusal(error)}") from error
