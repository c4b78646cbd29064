"""Job, part and operator of the next scans: a small file, so that they survive a restart."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from device.bundles.record import Record, decode_record, encode_record, read_small
from device.bundles.scan import Annotations
from device.errors import RecordError, StoreError
from device.io.atomic import replace_file
from device.io.os_errors import explain_os_error

STICKY_FILE: Final = "annotations.json"
STICKY_SCHEMA: Final = "retrograph.annotations/1"
_REMEDY: Final = "remove it, and enter job, part and operator again"


class StickyAnnotations(Record, frozen=True, tag_field="schema", tag=STICKY_SCHEMA):
    """Annotations that are stored with every scan until they are changed."""

    annotations: Annotations = Annotations()


def read_sticky(root: Path) -> Annotations:
    """The annotations of the next scans; empty when there are none or their file is damaged."""
    path = root / STICKY_FILE
    if not path.exists():
        return Annotations()
    try:
        return decode_record(read_small(path, _REMEDY), StickyAnnotations, path, _REMEDY).annotations
    except RecordError:
        return Annotations()


def write_sticky(root: Path, annotations: Annotations) -> None:
    """Store them durably.

    Raises
    ------
    StoreError
        The disk refused; the ones before are kept.
    """
    path = root / STICKY_FILE
    try:
        replace_file(path, encode_record(StickyAnnotations(annotations=annotations)))
    except OSError as error:
        raise StoreError(f"{path}: cannot be stored {explain_os_error(error)}") from error
