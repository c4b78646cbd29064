"""Common part of every record: strict, bounded JSON with a named schema version, and the hash and size of every file.

A manifest (`scan.json`, `calibration.json`) lists the bundle's files; `<manifest>.sha256` beside it is the checksum of
the manifest itself, in the form that `sha256sum -c` reads. So every byte of a bundle is covered by a hash.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, BinaryIO, Final, TypeVar

import msgspec

from device.errors import RecordError
from device.io.folder import FileTooLarge, Folder, IrregularFile, open_regular
from hal.validation import decode_json, explain_validation

CHUNK_BYTES: Final = 1 << 20
MAX_MANIFEST_BYTES: Final = 4 << 20
"""A manifest has a few kilobytes; a larger one than this is not read."""

MIN_YEAR: Final = 1900
MAX_YEAR: Final = 2999
"""A date outside these years is a damaged one, and beside year 1 or 9999 it cannot be converted to another zone."""

_MAX_COUNT: Final = (1 << 53) - 1
"""Integers up to this are exact in JSON readers of every language, in SQLite and in floating point."""

FileName = Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9][a-z0-9._-]{0,99}(?!\n)$")]
BundleId = Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9][a-z0-9-]{0,99}(?!\n)$")]
Sha256 = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}(?!\n)$")]
Text = Annotated[str, msgspec.Meta(max_length=4000)]
ShortText = Annotated[str, msgspec.Meta(max_length=200)]
Positive = Annotated[float, msgspec.Meta(gt=0, le=1e12)]
NotNegative = Annotated[float, msgspec.Meta(ge=0, le=1e12)]
Coordinate = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
Figure = Annotated[float, msgspec.Meta(ge=-1e30, le=1e30)]
Figures = Annotated[dict[ShortText, Figure | None], msgspec.Meta(max_length=1000)]
Count = Annotated[int, msgspec.Meta(ge=0, le=_MAX_COUNT)]
Nanoseconds = Annotated[int, msgspec.Meta(ge=-(1 << 63), le=(1 << 63) - 1)]
Size = Annotated[int, msgspec.Meta(ge=1, le=65536)]
Time = Annotated[datetime, msgspec.Meta(tz=True)]


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Part of a record: immutable, unknown keys and dates outside 1900 to 2999 refused."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, datetime) and not MIN_YEAR <= value.year <= MAX_YEAR:
                raise ValueError(f"Expected a year from {MIN_YEAR} to {MAX_YEAR} in `{name}`, got {value.year}")


class FileEntry(Record, frozen=True):
    """Hash and size (bytes) of one file of a bundle."""

    sha256: Sha256
    size: Annotated[int, msgspec.Meta(ge=0, le=1 << 40)]


Files = Annotated[dict[FileName, FileEntry], msgspec.Meta(max_length=1000)]


class Identity(Record, frozen=True):
    """Identity of a bundle; it does not depend on the wall clock.

    counter : of this device's scans, or of its calibrations, since it was first set up, over all boots
    monotonic_ns : time since this boot, ns
    """

    id: BundleId
    device_id: BundleId
    boot_id: BundleId
    counter: Count
    monotonic_ns: Nanoseconds


class _Header(msgspec.Struct):
    """The one key that is read before the version is known."""

    schema: str


RecordT = TypeVar("RecordT", bound=Record)


def encode_record(record: Record) -> bytes:
    """Return the record as indented JSON with a final newline; NaN becomes null."""
    return msgspec.json.format(msgspec.json.encode(record), indent=2) + b"\n"


def decode_record(data: bytes, kind: type[RecordT], source: str | Path, remedy: str = "fetch it again") -> RecordT:
    """Return the record in `data`; `remedy` ends the error's sentence.

    Raises
    ------
    RecordError
        Names `source`, and the version, or the key and its problem.
    """
    known = kind.__struct_config__.tag
    try:
        found = decode_json(data, _Header).schema
        if found != known:
            raise RecordError(
                f"{source}: its version is {found[:100]!r}, this program reads {known!r}: use a program that reads it"
            )
        return decode_json(data, kind)
    except msgspec.ValidationError as error:
        raise RecordError(f"{source}: {explain_validation(error)}: {remedy}") from error
    except msgspec.DecodeError as error:
        raise RecordError(f"{source}: {error}: {remedy}") from error


def sha256_bytes(data: bytes) -> str:
    """SHA-256 of bytes, in lower-case hex."""
    return hashlib.sha256(data).hexdigest()


def describe_file(path: Path) -> FileEntry:
    """Hash and size of a regular file, read in blocks."""
    with os.fdopen(open_regular(path), "rb") as stream:
        return describe_stream(stream)


def describe_stream(stream: BinaryIO) -> FileEntry:
    """Hash and size of what is left of a stream."""
    digest, size = hashlib.sha256(), 0
    while block := stream.read(CHUNK_BYTES):
        digest.update(block)
        size += len(block)
    return FileEntry(sha256=digest.hexdigest(), size=size)


def checksum_name(manifest: str) -> str:
    """Name of the checksum file of a manifest."""
    return f"{manifest}.sha256"


def manifest_checksum(manifest: str, data: bytes) -> bytes:
    """Return the content of a manifest's checksum file, as `sha256sum -c` reads it."""
    return f"{sha256_bytes(data)}  {manifest}\n".encode()


def read_manifest(directory: Path, manifest: str) -> bytes:
    """Return bytes of a bundle's manifest, compared with its checksum file.

    Raises
    ------
    RecordError
        The manifest or its checksum file is missing or damaged.
    """
    remedy = "fetch the bundle again"
    try:
        with Folder(directory, follow=False) as folder:
            data, checksum = (_small(folder, name, remedy) for name in (manifest, checksum_name(manifest)))
    except OSError as error:
        raise RecordError(f"{directory}: cannot be opened ({error.strerror}): {remedy}") from error
    check_manifest(data, checksum, directory / manifest)
    return data


def check_manifest(data: bytes, checksum: bytes, source: str | Path) -> None:
    """Refuse a manifest that does not agree with its checksum file.

    Raises
    ------
    RecordError
        Names `source`.
    """
    if checksum != manifest_checksum(Path(source).name, data):
        raise RecordError(f"{source}: does not agree with {Path(source).name}.sha256: fetch the bundle again")


def check_folder_name(directory: Path, identity: Identity) -> None:
    """Refuse a bundle in a folder that is not named by its id: a copy beside the original would count twice.

    Raises
    ------
    RecordError
        Names the folder.
    """
    if directory.name != identity.id:
        raise RecordError(f"{directory}: holds the bundle {identity.id}: give the folder that name, or remove the copy")


def read_small(path: Path, remedy: str = "fetch the bundle again") -> bytes:
    """Return bytes of a small regular file; `remedy` ends the error's sentence.

    Raises
    ------
    RecordError
        It is missing, unreadable, no regular file, or larger than any manifest.
    """
    try:
        with Folder(path.parent) as folder:
            return _small(folder, path.name, remedy)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror}): {remedy}") from error


def _small(folder: Folder, name: str, remedy: str) -> bytes:
    path = folder.path / name
    try:
        return folder.read(name, MAX_MANIFEST_BYTES)
    except FileTooLarge as error:
        raise RecordError(f"{path}: is larger than any manifest: {remedy}") from error
    except (FileNotFoundError, IrregularFile) as error:
        raise RecordError(f"{path}: is missing or no regular file: {remedy}") from error
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror}): {remedy}") from error


def verify_files(directory: Path, files: Mapping[str, FileEntry]) -> None:
    """Hash every listed file of a bundle and compare.

    Raises
    ------
    RecordError
        Names every file that is missing or differs.
    """
    try:
        with Folder(directory, follow=False) as folder:
            faults = [fault for name, entry in files.items() if (fault := _fault(folder, name, entry))]
    except OSError as error:
        faults = [f"it cannot be opened ({error.strerror})"]
    if faults:
        raise RecordError(f"{directory}: {', '.join(faults)}: fetch the bundle again")


def _fault(folder: Folder, name: str, expected: FileEntry) -> str | None:
    """Return what is wrong with a file, or None."""
    try:
        with folder.opened(name) as stream:
            size = os.fstat(stream.fileno()).st_size
            if size != expected.size:
                return f"{name} has {size} bytes instead of {expected.size}"
            if describe_stream(stream) != expected:
                return f"{name} is damaged (its SHA-256 differs)"
    except FileNotFoundError:
        return f"{name} is missing"
    except IrregularFile:
        return f"{name} is no regular file"
    except OSError as error:
        return f"{name} cannot be read ({error.strerror})"
    return None
