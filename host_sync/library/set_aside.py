"""Bundles that a library refused or moved out of the way: folders and reasons under `<library>/set-aside`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from device.bundles.layout import MANIFESTS, BundleKind, is_bundle_id
from device.bundles.record import Record, ShortText, Text, Time, decode_record, encode_record, read_small, sha256_bytes
from device.errors import RecordError
from device.io.atomic import replace_file, sync_directory

SET_ASIDE: Final = "set-aside"
_REASON: Final = ".reason.json"
_REMEDY: Final = "remove it"


class SetAsideReason(Record, frozen=True, tag_field="schema", tag="retrograph.set-aside/1"):
    """Why something was set aside, and from where it came."""

    kind: BundleKind
    name: ShortText
    reason: Text
    source: ShortText
    time: Time


@dataclass(frozen=True, slots=True)
class SetAsideEntry:
    """One entry: its reason, and its folder when one was moved here."""

    why: SetAsideReason
    folder: Path | None


def refuse(root: Path, kind: BundleKind, name: str, reason: str, source: str) -> None:
    """Note why a bundle of a source was not taken in; a later note on the same one replaces it.

    Raises
    ------
    OSError
        The disk refused.
    """
    folder = _folder(root, kind)
    safe = name if is_bundle_id(name) else f"entry-{sha256_bytes(name.encode(errors='surrogateescape'))[:16]}"
    _write_reason(folder / f"{safe}{_REASON}", kind, name, reason, source)


def accept(root: Path, kind: BundleKind, bundle_id: str) -> None:
    """Drop the note on a bundle that was taken in after all; a folder that was moved here stays."""
    place = root / SET_ASIDE / kind
    if not (place / bundle_id).exists():
        (place / f"{bundle_id}{_REASON}").unlink(missing_ok=True)


def move_aside(root: Path, kind: BundleKind, bundle_id: str, reason: str) -> Path:
    """Move a bundle of the library out of the way and note why; returns where it is now.

    Raises
    ------
    OSError
        The disk refused; the bundle stays in its place.
    """
    folder = _folder(root, kind)
    names = (f"{bundle_id}{suffix}" for suffix in ("", *(f"-{number}" for number in range(2, 1000))))
    target = next(folder / name for name in names if not os.path.lexists(folder / name))
    _write_reason(folder / f"{target.name}{_REASON}", kind, bundle_id, reason, str(root))
    (root / kind / bundle_id).rename(target)
    sync_directory(folder)
    sync_directory(root / kind)
    return target


def list_set_aside(root: Path) -> list[SetAsideEntry]:
    """Return every entry, by kind and name; a damaged note is an entry that says so."""
    found = []
    for kind in MANIFESTS:
        for path in sorted((root / SET_ASIDE / kind).glob(f"*{_REASON}")):
            folder = path.with_name(path.name.removesuffix(_REASON))
            found.append(SetAsideEntry(_read_reason(path, kind), folder if folder.is_dir() else None))
    return found


def _read_reason(path: Path, kind: BundleKind) -> SetAsideReason:
    try:
        return decode_record(read_small(path, _REMEDY), SetAsideReason, path, _REMEDY)
    except RecordError as error:
        name = path.name.removesuffix(_REASON)[:200]
        time = datetime.fromtimestamp(0, UTC)
        return SetAsideReason(kind=kind, name=name, reason=str(error)[:4000], source="", time=time)


def _folder(root: Path, kind: BundleKind) -> Path:
    folder = root / SET_ASIDE / kind
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _write_reason(path: Path, kind: BundleKind, name: str, reason: str, source: str) -> None:
    def shown(text: str, most: int) -> str:
        return text.encode(errors="backslashreplace").decode()[:most]

    record = SetAsideReason(
        kind=kind,
        name=shown(name, 200),
        reason=shown(reason, 4000),
        source=shown(source, 200),
        time=datetime.now(UTC).replace(microsecond=0),
    )
    replace_file(path, encode_record(record))
