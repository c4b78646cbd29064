"""A person's mark on a published scan: a small file beside the scans, because scans never change."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from device.bundles.record import BundleId, Record, decode_record, encode_record, read_small
from device.errors import RecordError, StoreError
from device.io.atomic import replace_file
from device.io.os_errors import explain_os_error

MARKS: Final = "marks"
MARK_SCHEMA: Final = "retrograph.mark/1"
_REMEDY: Final = "remove it and mark the scan again"

Opinion = Literal["good", "bad"]


class ScanMark(Record, frozen=True, tag_field="schema", tag=MARK_SCHEMA):
    """A person's opinion of a scan (None: no opinion) and a note."""

    scan_id: BundleId
    opinion: Opinion | None = None
    note: Annotated[str, msgspec.Meta(max_length=1000)] = ""


def mark_path(root: Path, scan_id: str) -> Path:
    """Path of a scan's mark, there or not."""
    return root / MARKS / f"{scan_id}.json"


def read_mark(root: Path, scan_id: str) -> ScanMark | None:
    """The mark of a scan; None when it has none or the file is damaged."""
    path = mark_path(root, scan_id)
    if not path.exists():
        return None
    try:
        return decode_record(read_small(path, _REMEDY), ScanMark, path, _REMEDY)
    except RecordError:
        return None


def write_mark(root: Path, mark: ScanMark) -> None:
    """Store a mark durably, replacing the one before.

    Raises
    ------
    RecordError
        There is no such scan.
    StoreError
        The disk refused; the mark before is kept.
    """
    if not (root / "scans" / mark.scan_id).is_dir():
        raise RecordError(f"there is no scan {mark.scan_id} in {root}: choose one from the history")
    path = mark_path(root, mark.scan_id)
    try:
        path.parent.mkdir(exist_ok=True)
        replace_file(path, encode_record(mark))
    except OSError as error:
        raise StoreError(f"{path}: the mark cannot be stored {explain_os_error(error)}") from error
