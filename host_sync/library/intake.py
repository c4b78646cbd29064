"""Bundles that a library took in or refused: the intake record, and `<library>/set-aside`.

The intake record is an append-only, hash-chained list of every bundle that the library has taken in. Bundles that it
refused or moved out of the way lie set aside, in folders with their reasons.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO, Final, Literal

import msgspec

from device.bundles.bundle import MANIFESTS, BundleKind, is_bundle_id
from device.bundles.record import (
    BundleId,
    Count,
    Record,
    Sha256,
    ShortText,
    Text,
    Time,
    decode_record,
    encode_record,
    read_small,
    sha256_bytes,
)
from device.errors import RecordError
from device.io.atomic import replace_file, sync_directory
from device.io.folder import open_appending, open_regular, sync_descriptor

INTAKE_FILE: Final = "intake.jsonl"
HEAD_FILE: Final = "intake.head"
_FIRST: Final = "0" * 64
_MAX_LINE_BYTES: Final = 4096
_REMEDY: Final = "restore it from a backup, or start a new one with `retrosync verify --adopt`"

Event = Literal["taken-in", "adopted", "set-aside", "forgotten"]
HELD: Final = frozenset({"taken-in", "adopted"})
"""After these events the library must hold the bundle."""

BundleKey = tuple[BundleKind, str]


class IntakeEntry(Record, frozen=True, tag_field="schema", tag="retrograph.intake/1"):
    """One line: what happened to a bundle.

    number : of the line, from 1
    previous : SHA-256 of the line before, zeros before the first
    event : taken in from a source, adopted as found, set aside as damaged, or forgotten because the user said so
    source : device or folder that it came from, for people
    time : by this workstation's clock; an annotation
    """

    number: Count
    previous: Sha256
    event: Event
    kind: BundleKind
    bundle_id: BundleId
    manifest_sha256: Sha256
    source: ShortText
    time: Time


class IntakeHead(Record, frozen=True, tag_field="schema", tag="retrograph.intake-head/1"):
    """Number and SHA-256 of the last line."""

    number: Count
    sha256: Sha256


@dataclass(frozen=True, slots=True)
class IntakeHistory:
    """Contents of an intake record.

    last : the last entry of each bundle
    count : number of lines
    fault : why the record cannot be trusted, or None
    """

    last: dict[BundleKey, IntakeEntry] = field(default_factory=dict)
    count: int = 0
    fault: str | None = None

    @property
    def held(self) -> dict[BundleKey, IntakeEntry]:
        """The bundles that the library must hold."""
        return {key: entry for key, entry in self.last.items() if entry.event in HELD}


def read_intake(root: Path) -> IntakeHistory:
    """Return the intake record of a library; empty without a fault when the library never had one.

    Raises
    ------
    OSError
        The record cannot be read.
    """
    path, head = root / INTAKE_FILE, _read_head(root)
    last: dict[BundleKey, IntakeEntry] = {}
    count, previous, at_head = 0, _FIRST, _FIRST
    try:
        with os.fdopen(open_regular(path), "rb") as stream:
            for line in _lines(stream):
                entry = _continuing(line, path, count, previous)
                count, previous = count + 1, sha256_bytes(line)
                at_head = previous if isinstance(head, IntakeHead) and count == head.number else at_head
                last[entry.kind, entry.bundle_id] = entry
    except FileNotFoundError:
        return IntakeHistory(fault=f"{path}: is missing: {_REMEDY}" if head is not None else None)
    except RecordError as error:
        return IntakeHistory(last, count, str(error))
    return IntakeHistory(last, count, _head_fault(root, head, count, at_head))


def append_intake(
    root: Path, event: Event, kind: BundleKind, bundle_id: str, manifest_sha256: str, source: str
) -> IntakeEntry:
    """Append one line, durably; returns it. The caller holds the library's lock, and one thread appends at a time.

    Raises
    ------
    OSError
        The disk refused; the record is unchanged.
    RecordError
        The last line is damaged.
    """
    with _appending(root / INTAKE_FILE) as stream:
        number, previous, end = _tail(stream, root / INTAKE_FILE)
        entry = IntakeEntry(
            number=number + 1,
            previous=previous,
            event=event,
            kind=kind,
            bundle_id=bundle_id,
            manifest_sha256=manifest_sha256,
            source=source.encode(errors="replace").decode()[:200],
            time=datetime.now(UTC).replace(microsecond=0),
        )
        if number == 0 and not (root / HEAD_FILE).exists():
            _store_head(root, IntakeHead(number=0, sha256=_FIRST))  # from now on a missing head is a lost one
        stream.truncate(end)  # what a power cut left of an unfinished line
        stream.seek(end)
        try:
            stream.write(msgspec.json.encode(entry) + b"\n")
            stream.flush()
            sync_descriptor(stream.fileno())
        except OSError:
            stream.truncate(end)
            raise
    return entry


def retire_intake(root: Path, folder: Path) -> None:
    """Move a record that cannot be trusted to a folder, so that the next entry starts a new one.

    Raises
    ------
    OSError
        The disk refused.
    """
    folder.mkdir(parents=True, exist_ok=True)
    number = next(n for n in range(1, 10_000) if not (folder / f"{n}-{INTAKE_FILE}").exists())
    for name in (HEAD_FILE, INTAKE_FILE):  # the head first: without the record it would be a fault
        with suppress(FileNotFoundError):
            (root / name).rename(folder / f"{number}-{name}")
    sync_directory(folder)
    sync_directory(root)


def write_head(root: Path) -> None:
    """Store number and hash of the last line beside the record; nothing when there is no record.

    Raises
    ------
    OSError, RecordError
        As for `append_intake`.
    """
    try:
        with os.fdopen(open_regular(root / INTAKE_FILE), "rb") as stream:
            number, sha256, _ = _tail(stream, root / INTAKE_FILE)
    except FileNotFoundError:
        return
    _store_head(root, IntakeHead(number=number, sha256=sha256))


def _continuing(line: bytes, path: Path, count: int, previous: str) -> IntakeEntry:
    """Return the entry of a line after `count` others, the last of which has the hash `previous`."""
    entry = decode_record(line, IntakeEntry, f"{path}, line {count + 1}", _REMEDY)
    if (entry.number, entry.previous) != (count + 1, previous):
        raise RecordError(f"{path}: line {count + 1} does not continue line {count}: {_REMEDY}")
    return entry


def _store_head(root: Path, head: IntakeHead) -> None:
    data = msgspec.json.encode(head) + b"\n"
    if not (root / HEAD_FILE).is_file() or (root / HEAD_FILE).read_bytes() != data:
        replace_file(root / HEAD_FILE, data)


def _head_fault(root: Path, head: IntakeHead | str | None, count: int, at_head: str) -> str | None:
    if head is None:
        return None if count == 0 else f"{root / HEAD_FILE}: is missing: {_REMEDY}"
    if isinstance(head, str):
        return head
    if count < head.number:
        return f"{root / INTAKE_FILE}: ends at line {count} and had {head.number}: {_REMEDY}"
    return None if at_head == head.sha256 else f"{root / INTAKE_FILE}: line {head.number} was changed: {_REMEDY}"


def _read_head(root: Path) -> IntakeHead | str | None:
    """Return the head; None when it is missing, a sentence when it is damaged."""
    path = root / HEAD_FILE
    try:
        with os.fdopen(open_regular(path), "rb") as stream:
            return decode_record(stream.read(_MAX_LINE_BYTES), IntakeHead, path, _REMEDY)
    except FileNotFoundError:
        return None
    except (RecordError, OSError) as error:
        return str(error)


def _lines(stream: BinaryIO) -> Iterator[bytes]:
    """Yield the complete lines without their newline; one that a power cut left unfinished counts as absent."""
    while line := stream.readline(_MAX_LINE_BYTES):
        if not line.endswith(b"\n"):
            if len(line) == _MAX_LINE_BYTES or stream.read(1):
                raise RecordError(f"{INTAKE_FILE}: holds a line that is too long: {_REMEDY}")
            return
        yield line[:-1]


def _tail(stream: BinaryIO, path: Path) -> tuple[int, str, int]:
    """Return the number and SHA-256 of the last complete line, and where it ends."""
    size = stream.seek(0, os.SEEK_END)
    start = max(size - 2 * _MAX_LINE_BYTES, 0)
    stream.seek(start)
    block = stream.read(size - start)
    complete = block.rfind(b"\n") + 1
    if complete == 0:
        if start:
            raise RecordError(f"{path}: holds a line that is too long: {_REMEDY}")
        return 0, _FIRST, 0
    line = block[block.rfind(b"\n", 0, complete - 1) + 1 : complete - 1]
    return decode_record(line, IntakeEntry, path, _REMEDY).number, sha256_bytes(line), start + complete


@contextmanager
def _appending(path: Path) -> Iterator[BinaryIO]:
    """The record, opened for reading and writing; made when absent."""
    made = not path.exists()
    descriptor = open_appending(path)
    with os.fdopen(descriptor, "r+b") as stream:
        if not path.is_file():
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        if made:
            sync_directory(path.parent)
        yield stream


SET_ASIDE: Final = "set-aside"
_REASON: Final = ".reason.json"
_REMOVE_IT: Final = "remove it"


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


def record_refusal(root: Path, kind: BundleKind, name: str, reason: str, source: str) -> None:
    """Note why a bundle of a source was not taken in; a later note on the same one replaces it.

    Raises
    ------
    OSError
        The disk refused.
    """
    folder = _folder(root, kind)
    safe = name if is_bundle_id(name) else f"entry-{sha256_bytes(name.encode(errors='surrogateescape'))[:16]}"
    _write_reason(folder / f"{safe}{_REASON}", kind, name, reason, source)


def forget_refusal(root: Path, kind: BundleKind, bundle_id: str) -> None:
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
        return decode_record(read_small(path, _REMOVE_IT), SetAsideReason, path, _REMOVE_IT)
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
