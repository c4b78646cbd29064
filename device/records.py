"""What every record shares: strict JSON with a named schema version, and the hash and size of every file.

A manifest (`scan.json`, `calibration.json`) lists the bundle's files; `<manifest>.sha256` beside it seals the manifest
itself, in the form that `sha256sum -c` reads, so that no byte of a bundle can rot unnoticed.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, TypeVar

import msgspec

from device.errors import RecordError

CHUNK_BYTES: Final = 1 << 20
MOST_MANIFEST_BYTES: Final = 4 << 20
"""A manifest is a few kilobytes; what is larger than this is not read."""

FileName = Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9][a-z0-9._-]{0,99}(?!\n)$")]
BundleId = Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9][a-z0-9-]{0,99}(?!\n)$")]
Sha256 = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}(?!\n)$")]
Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Count = Annotated[int, msgspec.Meta(ge=0)]
Size = Annotated[int, msgspec.Meta(ge=1, le=65536)]


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Part of a record: immutable, unknown keys refused."""


class FileEntry(Record, frozen=True):
    """Hash and size (bytes) of one file of a bundle."""

    sha256: Sha256
    size: Annotated[int, msgspec.Meta(ge=0, le=1 << 40)]


class Identity(Record, frozen=True):
    """What tells one bundle from all others; the wall clock has no part in it.

    counter : presses of this device since it was first set up, over all boots
    monotonic_ns : of the clock of this boot, ns
    """

    id: BundleId
    device_id: BundleId
    boot_id: BundleId
    counter: Count
    monotonic_ns: int


class _Header(msgspec.Struct):
    """The one key that is read before the version is known."""

    schema: str


RecordT = TypeVar("RecordT", bound=Record)


def encode_record(record: Record) -> bytes:
    """The record as indented JSON with a final newline; NaN becomes null."""
    return msgspec.json.format(msgspec.json.encode(record), indent=2) + b"\n"


def decode_record(data: bytes, kind: type[RecordT], source: str | Path, remedy: str = "fetch it again") -> RecordT:
    """The record that `data` holds; `remedy` is what to do when it does not.

    Raises
    ------
    RecordError
        Names `source`, and the version, or the key and its problem.
    """
    known = kind.__struct_config__.tag
    try:
        found = msgspec.json.decode(data, type=_Header).schema
        if found != known:
            raise RecordError(f"{source}: its version is {found!r}, known is {known!r}: use a program that knows it")
        return msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise RecordError(f"{source}: {explain_validation(error)}: {remedy}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordError(f"{source}: is not valid JSON ({error}): {remedy}") from error


def explain_validation(error: msgspec.ValidationError) -> str:
    """The key and what is wrong with it, such as "lights[0].name: Expected `str`, got `int`"."""
    problem, _, where = str(error).partition(" - at `")
    key = re.sub(r"^(key in )?\$\.?", "", where.rstrip("`"))
    return f"{key}: {problem}" if key else problem


def sha256_bytes(data: bytes) -> str:
    """SHA-256 of bytes, in lower-case hex."""
    return hashlib.sha256(data).hexdigest()


def describe_file(path: Path) -> FileEntry:
    """Hash and size of a file, read in blocks."""
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as stream:
        while block := stream.read(CHUNK_BYTES):
            digest.update(block)
            size += len(block)
    return FileEntry(sha256=digest.hexdigest(), size=size)


def seal_name(manifest: str) -> str:
    """Name of the file that seals a manifest."""
    return f"{manifest}.sha256"


def seal_of(manifest: str, data: bytes) -> bytes:
    """Content of the file that seals a manifest, as `sha256sum -c` reads it."""
    return f"{sha256_bytes(data)}  {manifest}\n".encode()


def read_manifest(directory: Path, manifest: str) -> bytes:
    """Bytes of a bundle's manifest, proven by its seal.

    Raises
    ------
    RecordError
        The manifest or its seal is missing or damaged.
    """
    data, seal = (read_small(directory / name) for name in (manifest, seal_name(manifest)))
    check_seal(data, seal, directory / manifest)
    return data


def check_seal(data: bytes, seal: bytes, source: str | Path) -> None:
    """Refuse a manifest that does not agree with its seal.

    Raises
    ------
    RecordError
        Names `source`.
    """
    if seal != seal_of(Path(source).name, data):
        raise RecordError(f"{source}: does not agree with its seal {Path(source).name}.sha256: fetch the bundle again")


def check_folder_name(directory: Path, identity: Identity) -> None:
    """Refuse a bundle in a folder that is not named by its id: a copy beside the original would count twice.

    Raises
    ------
    RecordError
        Names the folder.
    """
    if directory.name != identity.id:
        raise RecordError(f"{directory}: holds the bundle {identity.id}: name the folder so, or remove the copy")


def read_small(path: Path, remedy: str = "fetch the bundle again") -> bytes:
    """Bytes of a small regular file; `remedy` is what to do when there is none.

    Raises
    ------
    RecordError
        It is missing, unreadable, no regular file, or absurdly large.
    """
    try:
        if path.is_symlink() or not path.is_file():
            raise RecordError(f"{path}: is missing or no regular file: {remedy}")
        with path.open("rb") as stream:
            data = stream.read(MOST_MANIFEST_BYTES + 1)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror}): {remedy}") from error
    if len(data) > MOST_MANIFEST_BYTES:
        raise RecordError(f"{path}: is larger than any manifest: {remedy}")
    return data


def verify_files(directory: Path, files: Mapping[str, FileEntry]) -> None:
    """Hash every listed file of a bundle and compare.

    Raises
    ------
    RecordError
        Names every file that is missing or differs.
    """
    faults = [fault for name, entry in files.items() if (fault := _fault(directory / name, entry))]
    if faults:
        raise RecordError(f"{directory}: {', '.join(faults)}: fetch the bundle again")


def _fault(path: Path, expected: FileEntry) -> str | None:
    """What is wrong with a file, or None."""
    try:
        if path.is_symlink() or not path.is_file():
            return f"{path.name} is missing"
        size = path.stat().st_size
        if size != expected.size:
            return f"{path.name} has {size} bytes instead of {expected.size}"
        if describe_file(path) != expected:
            return f"{path.name} is damaged (its SHA-256 differs)"
    except OSError as error:
        return f"{path.name} cannot be read ({error.strerror})"
    return None
