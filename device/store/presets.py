"""Presets of job, part and operator, chosen instead of typed: a small file, newest first."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import msgspec

from device.bundles.record import Record, decode_record, encode_record, read_small
from device.bundles.scan import Annotations
from device.errors import RecordError, StoreError
from device.io.atomic import replace_file
from device.io.os_errors import explain_os_error

PRESETS_FILE: Final = "presets.json"
PRESETS_SCHEMA: Final = "retrograph.presets/1"
MAX_PRESETS: Final = 20
_REMEDY: Final = "remove it, and store the presets again"


class Presets(Record, frozen=True, tag_field="schema", tag=PRESETS_SCHEMA):
    """Labels that were stored to be chosen again."""

    items: Annotated[tuple[Annotations, ...], msgspec.Meta(max_length=MAX_PRESETS)] = ()


def read_presets(root: Path) -> tuple[Annotations, ...]:
    """The presets, newest first; none when there are none or their file is damaged."""
    path = root / PRESETS_FILE
    if not path.exists():
        return ()
    try:
        return decode_record(read_small(path, _REMEDY), Presets, path, _REMEDY).items
    except RecordError:
        return ()


def add_preset(root: Path, preset: Annotations) -> None:
    """Store a preset as the newest; the oldest of more than `MAX_PRESETS` goes.

    Raises
    ------
    StoreError
        The disk refused; the ones before are kept.
    """
    others = tuple(item for item in read_presets(root) if item != preset)
    path = root / PRESETS_FILE
    try:
        replace_file(path, encode_record(Presets(items=(preset, *others)[:MAX_PRESETS])))
    except OSError as error:
        raise StoreError(f"{path}: cannot be stored {explain_os_error(error)}") from error
